// What stands in front of the picture when no step is being played: rules, count-down, pause, outcome.

import { button, labelled, make, number, select } from './element.js';
import { options } from './game_bar.js';
import { css } from './scales.js';
import { episode, gameOn, welcome } from './state.js';

const PERSON = 'vantage-person';

const card = (...children) => make('div.card', { role: 'group', tabindex: '-1' }, ...children);

/** Rules in three lines, the name with its consent, and what is played. */
export function askCard(begin, leave, taken) {
  const { limits, layouts, seekers, catch_distance: reach, robot_colors: colors } = welcome();
  const known = localStorage.getItem(PERSON) ?? '';
  const name = make('input', { type: 'text', maxlength: limits.person, value: known, autocomplete: 'off', placeholder: 'optional' });
  const consent = make('input', { type: 'checkbox' }); // never ticked beforehand: the next person here may be another
  const fields = {
    games: number(3, 1, limits.games),
    steps: number(100, 1, limits.steps),
    period: number(0.25, ...limits.period, 0.05),
    seed: number(1 + Math.floor(Math.random() * 99999), 0, Number.MAX_SAFE_INTEGER),
    layout: select(options(layouts)),
    seeker: select(options(seekers)),
  };
  const submit = (event) => {
    event.preventDefault();
    const person = consent.checked ? name.value.trim() : '';
    if (person) localStorage.setItem(PERSON, person);
    else localStorage.removeItem(PERSON);
    const value = (key) => Number(fields[key].value);
    begin({ seed: value('seed'), games: value('games'), steps: value('steps'), period: value('period'), layout: fields.layout.value, seeker: fields.seeker.value, person });
  };
  const swatch = make('i.key.disc', { role: 'img', 'aria-label': 'its colour' });
  swatch.style.background = css(colors.seeker);
  return make('form.card.ask', { tabindex: '-1', onsubmit: submit },
    make('h2', {}, 'Play the hider'),
    make('ol.rules', {},
      make('li', {}, 'You drive the hider and see only what its camera sees. The seeker is the other robot: ', swatch, '.'),
      make('li', {}, `You are caught when the seeker comes within ${Math.round(100 * reach)} cm of you, centre to centre; you win when you last for all steps.`),
      make('li', {}, 'Arrow keys, W A S D or a gamepad: hold to drive or turn, a tap is one step. Space pauses. Boxes hide you.')),
    make('div.fields', {},
      labelled('games', fields.games, 'How many games this session has'),
      labelled('steps to survive', fields.steps, 'T'),
      labelled('step [s]', fields.period, 'The pace: seconds a step takes'),
      labelled('seed', fields.seed, 'The same seed gives the same layout and starts'),
      labelled('layout', fields.layout, 'Where the obstacles stand'),
      labelled('seeker', fields.seeker, 'glancing looks about for you; expert searches better')),
    make('div.consent', {},
      labelled('name or pseudonym', name),
      make('label.check', {}, consent, make('span', {}, 'store it with the recording'))),
    make('p.quiet', {}, 'Your moves are recorded as those of a human. Without the tick the recording has no name.'),
    taken ? make('p.trouble', {}, TAKEN) : gameOn() ? make('p.trouble', {}, 'A game is running: to begin ends it.') : null,
    make('div.buttons', {}, make('button.primary', { type: 'submit', disabled: taken }, 'Begin (Enter)'), button('Back to watching (Esc)', leave)));
}

/** Until the console has said what may be asked. */
export function connectCard() {
  return card(make('p', {}, 'Connecting to the console…'));
}

const TAKEN = 'Somebody is playing at another page now. Wait until that game is over.';

export function countCard(session) {
  return card(make('p.quiet', {}, `Game ${session.counted.length + 1} of ${session.options.games} starts in`),
    make('p.count', { 'aria-live': 'assertive' }, String(session.count)));
}

export function waitCard() {
  return card(make('p', {}, 'The table is being set up…'));
}

export function pauseCard(session) {
  return card(make('h2', {}, '❚❚ Paused'), make('p', {}, 'The step clock stands still; nothing moves.'),
    make('div.buttons', {}, button('Go on (space)', () => session.hold(), { class: 'primary' })));
}

function told(game) {
  if (game.outcome === 'survived') return ['◆ Survived', `You lasted all ${game.steps} steps.`];
  if (game.outcome === 'caught') return ['● Caught', `The seeker had you at step ${game.steps} of ${episode()?.rules.maximum_steps ?? '?'}.`];
  return ['✕ No result', game.reason || 'The game was stopped.'];
}

export function outcomeCard(session, leave, taken) {
  const { last, trouble } = session;
  const done = session.phase === 'done';
  const [title, text] = trouble || !last ? ['The session goes on', trouble ? `The next game did not start: ${trouble}.` : 'The page was loaded again.'] : told(last);
  const list = session.games.map((game, i) => make('li', { 'data-outcome': game.discarded ? 'discarded' : game.outcome },
    `${i + 1}: ${game.discarded ? 'discarded' : game.outcome === 'undecided' ? 'no result' : `${game.outcome}, ${game.steps} steps`}`));
  return make('div.card.outcome', { role: 'group', tabindex: '-1', 'data-outcome': last?.outcome ?? '' },
    make('h2', { 'aria-live': 'assertive' }, title), make('p', {}, text),
    last?.discarded ? make('p.quiet', {}, 'This game is marked as discarded and is not used as data.') : null,
    list.length ? make('ul.games', { 'aria-label': 'Games of this session' }, ...list) : null,
    make('p.quiet', {}, done ? 'The session is over. Thank you.' : `${session.counted.length} of ${session.options?.games ?? '?'} games played.`),
    taken && !done ? make('p.trouble', {}, TAKEN) : null,
    make('div.buttons', {},
      done ? button('Another session (Enter)', () => leave(true), { class: 'primary' })
        : button('Next game (Enter)', () => session.next(), { class: 'primary', disabled: taken }),
      last && !last.discarded ? button('Discard last (Backspace)', () => session.discard(), { title: 'The recording keeps it, marked as not to be used; you play it again' }) : null,
      button(done ? 'Watch (Esc)' : 'End session (Esc)', () => leave(false))));
}
