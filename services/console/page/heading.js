// The top line: where this is, how the game stands, the score, the recording, and the way between watching and playing.

import { button, make, setText, setTitle } from './element.js';
import { onChange } from './painting.js';
import { clockRuns, episode, header, replaying, state, step } from './state.js';

/** What a game is doing, in one word or two: [name for the colour, text]. */
export function phaseOf(game) {
  if (!game) return ['none', 'no game yet'];
  if (game.phase === 'setup') return ['setup', 'setting up'];
  if (game.phase === 'running') return game.paused ? ['paused', '❚❚ paused'] : ['running', '▶ running'];
  if (game.phase === 'aborted') return ['aborted', '✕ aborted'];
  return game.outcome === 'caught' ? ['caught', '● caught'] : ['survived', '◆ survived'];
}

export class Heading {
  /** @param {{watch: Function, play: Function, theme: Function, help: Function}} actions */
  constructor(root, actions) {
    const fact = (name, title) => {
      const value = make('span.value', {}, '–');
      const unit = make('span.label', {}, name);
      const element = make(`span.fact.${name.replace(/ /g, '-')}`, { title }, unit, value);
      element.value = value;
      return element;
    };
    this.place = make('span.place', {}, '');
    this.phase = make('span.chip', {}, 'no game yet');
    this.game = fact('game', 'Number of the game on this bus');
    this.seed = fact('seed', 'The same seed gives the same layout, start and camera noise');
    this.step = fact('step', 'Step reached, of the steps the hider has to survive (T)');
    this.players = fact('players', 'Who drives the hider, and the preset of the seeker');
    this.recording = make('span.chip', { title: 'Whether the recorder writes what is on the bus' }, 'recording –');
    this.connection = make('span.chip', {}, 'connecting');
    this.watch = button('Watch', actions.watch, { title: 'Watch the game (Esc in a game of your own)' });
    this.play = button('Play the hider', actions.play, { title: 'Drive the hider yourself (H)' });
    this.tabs = make('nav.tabs', { 'aria-label': 'Mode' }, this.watch, this.play);
    root.append(make('h1', {}, 'Vantage', make('span', {}, ' console')), this.place, this.tabs,
      make('div.facts-row', {}, this.phase, this.game, this.seed, this.step, this.players),
      make('div.aside', {}, this.recording, this.connection,
        button('◐', actions.theme, { title: 'Dark or light (T)', 'aria-label': 'Change between dark and light' }),
        button('?', actions.help, { title: 'Keys (?)', 'aria-label': 'Show the keys' })));
    onChange(['welcome', 'episode', 'tick', 'recording', 'connected', 'mode', 'playback'], () => this.paint());
  }

  paint() {
    const place = header('welcome');
    setText(this.place, place ? [place.deployment, place.arena].filter(Boolean).join(' · ') : '');
    const game = episode();
    const [name, text] = phaseOf(game);
    this.phase.dataset.state = name;
    setText(this.phase, text);
    setTitle(this.phase, game?.reason ?? '');
    setText(this.game.value, game ? String(game.episode) : '–');
    setText(this.seed.value, game ? String(game.seed) : '–');
    setText(this.step.value, game ? `${step()} / ${game.rules.maximum_steps}` : '–');
    setText(this.players.value, game ? `${game.players.hider} v. ${game.players.seeker}` : '–');
    const recording = header('recording');
    this.recording.dataset.state = recording?.state ?? 'off';
    const said = { on: '● recording', off: '○ not recording', trouble: '▲ recording trouble' }[recording?.state] ?? '○ recording –';
    setText(this.recording, recording?.reason ? `${said}: ${recording.reason}` : said);
    this.recording.hidden = replaying();
    this.connection.dataset.state = state.connected ? 'ok' : 'silent';
    setText(this.connection, state.connected ? '● connected' : '✕ not connected');
    this.watch.setAttribute('aria-pressed', String(state.mode === 'watch'));
    this.play.setAttribute('aria-pressed', String(state.mode === 'play'));
    this.play.disabled = replaying();
    document.title = game && clockRuns() ? `step ${step()} · Vantage console` : 'Vantage console';
  }
}
