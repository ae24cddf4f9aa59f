// A person's session of several games: what comes after what. No elements here; `play.js` shows it.

import { episode, gameOn, header, seriesOn, state, welcome } from './state.js';
import { touch } from './painting.js';

const KEPT = 'vantage-play';
const COUNT = 3; // s before a game starts
const PATIENCE = 12000; // ms for a game to be set up

const driver = () => header('session')?.driver ?? null; // client number of the page at the wheel, 0: nobody

/**
 * Phases: `ask` (rules and name) -> `count` (3, 2, 1) -> `asked` (the referee sets it up) -> `game` -> `between` -> `count` ..
 * -> `done`. A game that is discarded or aborted is played again.
 */
export class PlaySession {
  constructor(send) {
    this.send = send;
    this.phase = 'ask';
    this.options = null; // seed, games, steps, period, layout, seeker, person
    this.games = []; // {episode, outcome, steps, discarded, reason}
    this.episode = null;
    this.before = null;
    this.pending = false; // a start was asked for that neither began nor was taken back
    this.count = 0;
    this.trouble = '';
    this.timer = 0;
    this.recall();
  }

  /** Whether somebody else drives the hider now. */
  static taken() {
    return gameOn() && episode().players.hider === 'human' && Boolean(driver()) && !PlaySession.drives();
  }

  /** Whether this page is at the wheel. */
  static drives() {
    return Boolean(driver()) && driver() === welcome()?.client;
  }

  get counted() {
    return this.games.filter((game) => !game.discarded && game.outcome !== 'undecided');
  }

  get last() {
    return this.games[this.games.length - 1] ?? null;
  }

  begin(options) {
    if (!header('session') || PlaySession.taken()) return; // who drives is not known yet, or somebody does
    this.options = options;
    this.games = [];
    this.next();
  }

  next() {
    if (!header('session') || PlaySession.taken()) return;
    if (seriesOn()) this.send({ type: 'stop' }); // somebody watches a game of the planner
    this.trouble = '';
    this.count = COUNT;
    this.to('count');
    this.timer = setInterval(() => {
      this.count -= 1;
      if (this.count > 0) this.to('count');
      else this.start();
    }, 1000);
  }

  start() {
    clearInterval(this.timer);
    const { seed, steps, period, layout, seeker, person } = this.options;
    this.before = episode()?.episode ?? null;
    // A game that does not count is played again: the same layout and starts.
    const sent = this.send({ type: 'start', seed: seed + this.counted.length, games: 1, steps, layout, hider: 'human', seeker, period, person });
    if (!sent) this.fail('not connected');
    else {
      this.pending = true;
      this.to('asked');
      this.wait();
    }
  }

  wait() {
    this.timer = setTimeout(() => this.phase === 'asked' && this.fail('no game was set up: is the referee running?'), PATIENCE);
  }

  fail(why) {
    clearTimeout(this.timer);
    this.trouble = why;
    this.takeBack();
    this.to('between');
  }

  /** The console's word against what this page asked for. */
  refused(why) {
    if (this.phase === 'asked') this.fail(why);
  }

  /** Nobody is to be surprised by a game that begins minutes later; somebody else's game is none of ours. */
  takeBack() {
    if (!this.pending || !(PlaySession.drives() || (driver() === 0 && !gameOn()))) return;
    this.pending = !this.send({ type: 'stop' });
  }

  /** Take in how the game stands. */
  observe() {
    const game = episode();
    if (!game) return;
    this.observeDiscard();
    const ours = PlaySession.drives() || driver() === 0; // nobody: this page was loaded again meanwhile
    if (this.phase === 'asked' && game.players.hider === 'human' && game.episode !== this.before && ours) {
      clearTimeout(this.timer);
      this.pending = false;
      this.episode = game.episode;
      this.to('game');
    }
    if (this.phase !== 'game') return;
    const mine = game.episode === this.episode;
    if (mine && gameOn()) return;
    this.games.push({
      episode: this.episode, discarded: false, reason: mine ? game.reason : 'the game was lost',
      outcome: mine && game.phase === 'ended' ? game.outcome : 'undecided',
      steps: mine ? game.caught_step ?? game.step : 0,
    });
    this.episode = null;
    this.to(this.counted.length >= this.options.games ? 'done' : 'between');
  }

  /** The console says what was taken back. */
  observeDiscard() {
    const said = header('session')?.last;
    const { last } = this;
    if (!said?.discarded || !last || last.discarded || said.episode !== last.episode) return;
    last.discarded = true;
    this.to(this.phase === 'done' ? 'between' : this.phase);
  }

  hold() {
    if (this.phase === 'game') this.send({ type: episode()?.paused ? 'resume' : 'pause' });
  }

  /** Take the last game back: the log keeps it, marked; it is played again. */
  discard() {
    if (!['between', 'done'].includes(this.phase) || !this.last || this.last.discarded) return;
    this.send({ type: 'discard', episode: this.last.episode });
  }

  leave() {
    clearInterval(this.timer);
    clearTimeout(this.timer);
    if (this.phase === 'game' && gameOn()) this.send({ type: 'stop' });
    this.takeBack();
    this.phase = 'ask';
    this.episode = null;
    sessionStorage.removeItem(KEPT);
  }

  to(phase) {
    this.phase = phase;
    const { options, games, episode: number, before, pending } = this;
    if (options) sessionStorage.setItem(KEPT, JSON.stringify({ phase, options, games, episode: number, before, pending }));
    state.play = { phase, games, count: this.count };
    touch('play');
  }

  /** After a reload the session goes on where it was; a count-down begins at the next press. */
  recall() {
    try {
      const kept = JSON.parse(sessionStorage.getItem(KEPT));
      if (!kept) return;
      Object.assign(this, kept, { phase: kept.phase === 'count' ? 'between' : kept.phase });
      if (this.phase === 'asked') this.wait();
    } catch {
      sessionStorage.removeItem(KEPT);
    }
  }

  static kept() {
    return sessionStorage.getItem(KEPT) !== null;
  }
}
