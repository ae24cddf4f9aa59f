// Start, pause and stop games.

import { button, labelled, make, number, select, setText } from './element.js';
import { onChange } from './painting.js';
import { episode, gameOn, held, header, replaying, seriesOn, welcome } from './state.js';

export const options = (names) => names.map((name) => [name, name]);

export class GameBar {
  /** @param {(request: Object) => boolean} send @param {() => void} play enters play mode. */
  constructor(send, play) {
    this.send = send;
    this.playMode = play;
    this.fields = null;
    this.known = null; // the game whose seed the field has gone past
    this.form = make('div.choices');
    this.start = make('button.primary', { type: 'submit', title: 'Start these games (G)' }, 'Start');
    this.pause = button('Pause', () => this.hold(), { title: 'Hold the step clock, or let it go on (space)' });
    this.stop = button('Stop', () => this.end(), { title: 'End the games (X)' });
    this.score = make('span.value', {}, '–');
    this.root = make('form.bar', { 'aria-label': 'Games', onsubmit: (event) => {
      event.preventDefault();
      this.begin();
    } },
    make('h2', {}, 'Games'), this.form,
    make('div.buttons', {}, this.start, this.pause, this.stop),
    make('span.fact.score', { title: 'Games since the console started' }, make('span.label', {}, 'score'), this.score));
    this.unlisten = [onChange(['welcome', 'episode', 'session', 'playback', 'connected', 'score'], () => this.paint())];
  }

  /** The fields come with the console's word on what may be asked. */
  build() {
    if (this.fields || !welcome()) return;
    const { limits, layouts, seekers } = welcome();
    this.fields = {
      seed: number(1, 0, Number.MAX_SAFE_INTEGER),
      games: number(1, 0, limits.games),
      steps: number(100, 1, limits.steps),
      period: number(0.25, 0, limits.period[1], 0.05),
      layout: select(options(layouts)),
      seeker: select(options(seekers)),
      hider: select([['planner', 'planner'], ['human', 'you']]),
    };
    const { fields } = this;
    this.form.replaceChildren(
      labelled('seed', fields.seed, 'Seed of the first game; the next games count on from it'),
      labelled('games', fields.games, 'How many games; 0 = until stopped'),
      labelled('T [steps]', fields.steps, 'Steps the hider has to survive'),
      labelled('step [s]', fields.period, 'Seconds a step takes; 0 = as fast as the players answer'),
      labelled('layout', fields.layout, 'Where the obstacles stand'),
      labelled('seeker', fields.seeker, 'glancing looks about for the hider; expert searches better'),
      labelled('hider', fields.hider, 'Who drives the hider: the planner, or you'));
  }

  close() {
    this.unlisten.forEach((stop) => stop());
  }

  begin() {
    this.build(); // a key may come before the welcome is painted
    const { fields } = this;
    if (!fields) return;
    if (fields.hider.value === 'human') this.playMode();
    else if (this.root.reportValidity()) {
      this.send({
        type: 'start', seed: Number(fields.seed.value), games: Number(fields.games.value), steps: Number(fields.steps.value),
        layout: fields.layout.value, hider: 'planner', seeker: fields.seeker.value, period: Number(fields.period.value), person: '',
      });
      fields.seed.value = Number(fields.seed.value) + Math.max(1, Number(fields.games.value)); // the next click is another game
    }
  }

  hold() {
    this.send({ type: held() ? 'resume' : 'pause' });
  }

  end() {
    this.send({ type: 'stop' });
  }

  /** The next game to be watched is another one, whoever started those before. */
  goPast(game) {
    const { seed } = this.fields;
    if (!game || game.episode === this.known || document.activeElement === seed) return;
    this.known = game.episode;
    if (game.seed >= Number(seed.value)) seed.value = game.seed + 1;
  }

  paint() {
    this.build();
    if (this.fields) this.goPast(episode());
    this.root.hidden = replaying();
    this.start.disabled = gameOn() || !this.fields;
    this.pause.disabled = !seriesOn() && !held();
    this.stop.disabled = !seriesOn();
    const score = header('score');
    setText(this.score, score?.games
      ? `${score.survived} survived, ${score.caught} caught` : 'no game has ended');
    this.score.title = score?.games
      ? `mean ${Number(score.mean_steps ?? 0).toFixed(0)} steps; ${score.aborted} aborted, ${score.discarded} discarded` : '';
    setText(this.pause, held() ? 'Go on' : 'Pause');
  }
}
