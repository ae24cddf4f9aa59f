// Start, pause and stop games.

import { button, labelled, make, number, select, setText } from './element.js';
import { onChange } from './painting.js';
import { episode, gameOn, header, replaying, welcome } from './state.js';

export const SEEKERS = [['glancing', 'glancing'], ['expert', 'expert']];
export const LAYOUTS = [['random', 'random'], ['lab', 'lab']];

export class GameBar {
  /** @param {(request: Object) => boolean} send @param {() => void} play enters play mode. */
  constructor(send, play) {
    this.send = send;
    this.playMode = play;
    this.fields = {
      seed: number(1, 0, 2 ** 31),
      games: number(1, 0, 10000),
      steps: number(100, 1, 1000),
      period: number(0.25, 0, 10, 0.05),
      layout: select(LAYOUTS, 'random'),
      seeker: select(SEEKERS, 'glancing'),
      hider: select([['planner', 'planner'], ['human', 'you']], 'planner'),
    };
    const { fields } = this;
    this.start = make('button.primary', { type: 'submit', title: 'Start these games (G)' }, 'Start');
    this.pause = button('Pause', () => this.hold(), { title: 'Hold the step clock, or let it go on (space)' });
    this.stop = button('Stop', () => send({ type: 'stop' }), { title: 'End the games (X)' });
    this.score = make('span.value', {}, '–');
    this.root = make('form.bar', { 'aria-label': 'Games', onsubmit: (event) => {
      event.preventDefault();
      this.begin();
    } },
    make('h2', {}, 'Games'),
    labelled('seed', fields.seed, 'Seed of the first game; the next games count on from it'),
    labelled('games', fields.games, 'How many games; 0 = until stopped'),
    labelled('T [steps]', fields.steps, 'Steps the hider has to survive'),
    labelled('step [s]', fields.period, 'Seconds a step takes; 0 = as fast as the players answer'),
    labelled('layout', fields.layout, 'Where the obstacles stand'),
    labelled('seeker', fields.seeker, 'glancing looks about for the hider; expert searches better'),
    labelled('hider', fields.hider, 'Who drives the hider: the planner, or you'),
    make('div.buttons', {}, this.start, this.pause, this.stop),
    make('span.fact.score', { title: 'Games since the console started' }, make('span.label', {}, 'score'), this.score));
    this.unlisten = [onChange(['welcome', 'episode', 'playback', 'connected', 'score'], () => this.paint())];
  }

  close() {
    this.unlisten.forEach((stop) => stop());
  }

  begin() {
    const { fields } = this;
    if (fields.hider.value === 'human') this.playMode();
    else {
      this.send({
        type: 'start', seed: Number(fields.seed.value), games: Number(fields.games.value), steps: Number(fields.steps.value),
        layout: fields.layout.value, hider: 'planner', seeker: fields.seeker.value, period: Number(fields.period.value), person: '',
      });
      fields.seed.value = Number(fields.seed.value) + Math.max(1, Number(fields.games.value)); // the next click is another game
    }
  }

  hold() {
    this.send({ type: episode()?.paused ? 'resume' : 'pause' });
  }

  paint() {
    const limits = welcome()?.limits ?? {};
    if (limits.steps) this.fields.steps.max = limits.steps;
    if (limits.games) this.fields.games.max = limits.games;
    this.root.hidden = replaying();
    this.start.disabled = gameOn();
    this.pause.disabled = episode()?.phase !== 'running';
    this.stop.disabled = !gameOn();
    const score = header('score');
    setText(this.score, score?.games
      ? `${score.survived} survived, ${score.caught} caught` : 'no game has ended');
    this.score.title = score?.games
      ? `mean ${Number(score.mean_steps ?? 0).toFixed(0)} steps; ${score.aborted} aborted, ${score.discarded} discarded` : '';
    setText(this.pause, episode()?.paused && episode()?.phase === 'running' ? 'Go on' : 'Pause');
  }
}
