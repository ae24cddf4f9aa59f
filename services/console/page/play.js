// Playing the hider: its own eyes and nothing else.

import { button, make, setText } from './element.js';
import { Drive, PRIMITIVES } from './drive.js';
import { onChange } from './painting.js';
import { paintColor, paintView } from './pictures.js';
import { askCard, connectCard, countCard, outcomeCard, pauseCard, waitCard } from './play_cards.js';
import { PlaySession } from './play_session.js';
import { classes } from './robots.js';
import { clockRuns, episode, header, ofThisGame, patience, payload, state, step, welcome } from './state.js';

const SHOWN = 'vantage-state-image';
const ARROWS = { forward: '↑', backward: '↓', left: '↶', right: '↷' };

export class Play {
  /** @param {(request: Object) => boolean} send @param {() => void} leave back to watching. */
  constructor(send, leave) {
    this.leaveMode = leave;
    this.send = send;
    this.session = new PlaySession(send);
    this.viewShown = localStorage.getItem(SHOWN) === 'true';
    this.color = make('canvas.smooth', { role: 'img', 'aria-label': 'What the hider’s camera sees' });
    this.view = make('canvas.pixels', { role: 'img', 'aria-label': 'The hider’s state image: what it sees now, from above' });
    this.age = make('span.age');
    this.cover = make('div.cover');
    this.remaining = make('b.big', {}, '–');
    this.seconds = make('span.quiet', {}, '');
    this.step = make('b', {}, '–');
    this.pace = make('b', {}, '–');
    this.number = make('b', {}, '–');
    this.bar = make('div.progress-done');
    const fact = (label, ...values) => make('div.fact', {}, make('span.label', {}, label), ...values);
    this.pads = Object.fromEntries(PRIMITIVES.map((primitive) => [primitive, this.pad(primitive)]));
    this.toggle = button('State image (I)', () => this.showView(!this.viewShown), { 'aria-pressed': String(this.viewShown) });
    this.classes = make('ul.classes');
    this.second = make('figure.own-view', { hidden: !this.viewShown }, this.view, make('figcaption', {}, 'your state image: what you see, from above'), this.classes);
    this.root = make('section.play', { 'aria-label': 'Play the hider' },
      make('div.play-facts', {}, fact('to survive', this.remaining, make('span', {}, ' steps '), this.seconds),
        fact('step', this.step), fact('pace', this.pace), fact('game', this.number)),
      make('div.progress', { role: 'presentation' }, this.bar),
      make('div.eyes', {}, make('figure.own-color', {}, this.color, this.age, this.cover), this.second),
      make('div.controls', {}, make('div.pad', { role: 'group', 'aria-label': 'Drive' }, ...Object.values(this.pads)),
        button('Pause (space)', () => this.session.hold()), this.toggle, button('End session (Esc)', () => this.mayLeave() && this.leave(false))));
    this.wheel = false; // whether what is held was said to the console
    this.drive = new Drive((primitive, held) => this.driven(primitive, held), () => this.session.hold());
    this.unlisten = [
      onChange(['hider/color', 'welcome'], () => this.paintColor()),
      onChange(['hider/view', 'welcome'], () => this.paintView()),
      onChange(['episode', 'session', 'welcome'], () => this.session.observe()),
      onChange(['episode', 'session', 'play'], () => this.takeWheel()),
      onChange(['episode', 'session', 'welcome', 'play', 'connected'], () => this.paintCover()),
      onChange(['episode', 'tick', 'play', 'second', 'connected', 'welcome'], () => this.paintFacts()),
    ];
    this.paintCover();
    this.paintFacts();
  }

  close() {
    this.unlisten.forEach((stop) => stop());
    this.drive.close();
    this.session.leave();
  }

  pad(primitive) {
    const press = (held) => () => this.drive.set(primitive, 'pointer', held);
    return make(`button.${primitive}`, {
      type: 'button', tabindex: '-1', onmousedown: (event) => event.preventDefault(), 'aria-label': primitive, title: primitive,
      onpointerdown: press(true), onpointerup: press(false), onpointerleave: press(false), oncontextmenu: (event) => event.preventDefault(),
    }, ARROWS[primitive]);
  }

  driven(primitive, held) {
    this.pads[primitive].classList.toggle('held', held);
    if (this.session.phase === 'game') this.send({ type: 'drive', primitive, held });
  }

  /** A key that was held before the game began, or while nobody drove, counts from the first step on. */
  takeWheel() {
    const wheel = this.session.phase === 'game' && PlaySession.drives();
    if (wheel && !this.wheel) this.drive.sayAll();
    this.wheel = wheel;
  }

  showView(shown) {
    this.viewShown = shown;
    localStorage.setItem(SHOWN, String(shown));
    this.toggle.setAttribute('aria-pressed', String(shown));
    this.second.hidden = !shown;
    this.paintView();
  }

  /** Whether a game that this would end may be ended. */
  mayLeave() {
    return this.session.phase !== 'game' || confirm('This ends your game. Go back to watching?');
  }

  /** @param {boolean} again another session, else back to watching. */
  leave(again) {
    this.session.leave();
    if (again) this.paintCover();
    else this.leaveMode();
  }

  /** Enter, Backspace: what they do depends on the card that is shown. Returns false where they do nothing. */
  go() {
    if (this.session.phase === 'between') this.session.next();
    else if (this.session.phase === 'done') this.leave(true);
    else if (this.session.phase === 'ask') this.cover.querySelector('form')?.requestSubmit();
    else return false;
    return true;
  }

  paintColor() {
    const found = header('hider/color');
    if (!found || this.session.phase === 'ask') return;
    paintColor(this.color, payload('hider/color'), found.width, found.height);
  }

  paintView() {
    if (this.viewShown && welcome() && !this.classes.children.length) this.classes.append(...classes());
    if (this.viewShown && welcome() && header('hider/view')) paintView(this.view, payload('hider/view'), 'hider');
  }

  paintCover() {
    const { session } = this;
    const paused = session.phase === 'game' && episode()?.paused;
    const starting = session.phase === 'game' && episode()?.phase === 'setup';
    const taken = PlaySession.taken();
    const shown = [session.phase, paused, starting, session.count, session.games.length, session.last?.discarded, session.trouble, taken, Boolean(welcome())].join();
    if (shown === this.shown) return; // a form that is being filled in must not be made anew
    this.shown = shown;
    let card = null;
    if (!welcome()) card = connectCard();
    else if (session.phase === 'ask') card = askCard((options) => session.begin(options), () => this.leave(false), taken);
    else if (session.phase === 'count') card = countCard(session);
    else if (session.phase === 'asked' || starting) card = waitCard();
    else if (paused) card = pauseCard(session);
    else if (session.phase !== 'game') card = outcomeCard(session, (again) => this.leave(again), taken);
    this.cover.replaceChildren(...(card ? [card] : []));
    this.cover.hidden = !card;
    this.root.classList.toggle('asking', session.phase === 'ask');
    if (['ask', 'between', 'done'].includes(session.phase)) this.drive.release();
    // Not on a button: a space or Enter that was meant for the game must not press one.
    if (card) card.focus({ preventScroll: true });
    else document.activeElement?.blur?.();
  }

  paintFacts() {
    const { session } = this;
    const playing = session.phase === 'game' && episode();
    const rules = playing ? episode().rules : null;
    const total = rules?.maximum_steps ?? session.options?.steps ?? null;
    const over = ['between', 'done'].includes(session.phase) ? session.last : null;
    const done = playing ? step() : over?.steps ?? 0;
    const period = rules?.step_period ?? session.options?.period ?? null;
    setText(this.remaining, total === null ? '–' : String(Math.max(0, total - done)));
    setText(this.seconds, total === null ? '' : `≈ ${((total - done) * period).toFixed(0)} s`);
    setText(this.step, total === null ? '–' : `${done} of ${total}`);
    setText(this.pace, period === null ? '–' : period > 0 ? `${(1 / period).toFixed(1)} steps/s` : 'as fast as you answer');
    const before = session.counted.length - (session.counted.includes(over) ? 1 : 0); // one that does not count is played again
    setText(this.number, session.options ? `${Math.min(before + 1, session.options.games)} of ${session.options.games}` : '–');
    this.bar.style.width = total ? `${(100 * done) / total}%` : '0';
    const frame = state.frames['hider/color'];
    const age = frame ? (performance.now() - frame.arrived) / 1000 : 0;
    const stale = playing && (!state.connected || (clockRuns() && age > patience()));
    this.color.classList.toggle('stale', Boolean(stale));
    setText(this.age, stale ? `picture ${age.toFixed(0)} s old` : '');
    this.color.hidden = !ofThisGame('hider/color') || session.phase === 'ask';
  }
}
