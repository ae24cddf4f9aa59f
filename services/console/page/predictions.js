// What the seeker would see along the plan to a goal, predicted, and under it what it really saw.

import { make, panel, sentence, setText } from './element.js';
import { onChange } from './painting.js';
import { blank, paintPredicted, paintView } from './pictures.js';
import { episode, gameOn, ofThisGame, payload, state, step, welcome } from './state.js';
import { nameOf, worthOf } from './value_map.js';

export class Predictions {
  /** @param {(request: Object) => boolean} send */
  constructor(send) {
    this.send = send;
    this.wanted = new Set(); // steps whose true views were asked for
    this.past = null; // the views known when they were
    this.title = make('p.facts', { 'aria-live': 'polite' }, ' ');
    this.row = make('div.predictions-row', { role: 'list' });
    const { root } = panel('predictions', 'Seeker’s view: predicted and true',
      'Click a goal: what would the seeker see on the way there?',
      this.title, this.row);
    this.root = root;
    this.cells = [];
    this.count = null; // of steps shown
    this.unlisten = [
      onChange(['prediction', 'goal', 'episode', 'welcome', 'hider/plan'], () => this.paint()),
      onChange(['past', 'tick', 'prediction'], () => this.paintTrue()),
    ];
  }

  close() {
    this.unlisten.forEach((stop) => stop());
  }

  paint() {
    if (!welcome()) return;
    const found = ofThisGame('prediction');
    this.headline(found);
    const steps = found && !found.error ? found.steps : [];
    if (this.count !== steps.length) this.build(steps.length);
    const bytes = payload('prediction');
    const size = steps.length ? bytes.length / steps.length : 0;
    steps.forEach((at, i) => {
      const cell = this.cells[i];
      const percent = Math.round(100 * found.caught[i]);
      setText(cell.step, `step ${at}`);
      setText(cell.chance, `${percent} %`);
      cell.percent.dataset.level = percent >= 50 ? 'high' : 'low';
      cell.root.setAttribute('aria-label', `Step ${at}: caught with ${percent} percent`);
      paintPredicted(cell.predicted, bytes.subarray(i * size, (i + 1) * size));
    });
    this.paintTrue();
  }

  headline(found) {
    const thePlan = ofThisGame('hider/plan');
    let text;
    if (state.asked !== null) text = `Asking the predictor about ${nameOf(state.asked)}…`;
    else if (found?.error) text = `No prediction for ${nameOf(found.goal)}: ${found.error}`;
    else if (found) {
      const own = thePlan?.goal === found.goal;
      text = `To ${nameOf(found.goal)}, ${own ? 'the hider’s goal' : 'your goal'}: ${worthOf(found.goal)}; predicted in `
        + `${(found.elapsed * 1000).toFixed(0)} ms.${own ? '' : ' True: on the way really driven.'}`;
    } else if (thePlan) text = thePlan.unpredictable ? sentence(thePlan.unpredictable) : 'Click a coloured square in the arena.';
    else if (gameOn() && episode().players.hider === 'human') text = 'A person drives the hider: there is no plan to predict along.';
    else text = 'Waits for the plan of a game; then click a coloured square in the arena.';
    setText(this.title, text);
  }

  /** Without a prediction the row shows empty frames, so that nothing moves when one comes. */
  build(count) {
    this.count = count;
    this.cells = Array.from({ length: count || welcome().horizons }, () => {
      const cell = {
        step: make('span.step'), chance: make('span'), truth: make('span.quiet'),
        predicted: make('canvas.pixels', { role: 'img', 'aria-label': 'predicted seeker view' }),
        actual: make('canvas.pixels', { role: 'img', 'aria-label': 'true seeker view' }),
      };
      cell.percent = make('b.percent', {}, cell.chance, make('span.word', {}, ' caught'));
      cell.root = make(`div.prediction${count ? '' : '.blank'}`, { role: 'listitem' },
        make('div.caption', { title: 'Probability that the hider is caught by this step' }, cell.step, cell.percent),
        cell.predicted, make('div.actual', {}, cell.actual, cell.truth));
      return cell;
    });
    this.row.replaceChildren(make('div.sides', { 'aria-hidden': 'true' },
      make('span', {}, ''), make('span', {}, 'predicted'), make('span', {}, 'true')), ...this.cells.map((cell) => cell.root));
  }

  paintTrue() {
    const found = ofThisGame('prediction');
    if (!found || found.error || this.count !== found.steps.length) return;
    if (this.past !== state.past) { // forgotten: another game, another connection, a replay that jumped
      this.past = state.past;
      this.wanted.clear();
    }
    const missing = [];
    const known = state.pastOf === found.episode ? state.past : new Map();
    found.steps.forEach((at, i) => {
      const cell = this.cells[i];
      const view = known.get(at);
      if (view && cell.drawn !== view) {
        paintView(cell.actual, view, 'seeker');
        cell.drawn = view;
      } else if (!view && cell.drawn) {
        blank(cell.actual);
        cell.drawn = null;
      }
      const over = ['ended', 'aborted'].includes(episode()?.phase);
      const ahead = at - step();
      setText(cell.truth, view ? '' : ahead > 0 ? (over ? 'game over before' : `in ${ahead} steps`) : 'asked for…');
      cell.truth.hidden = Boolean(view);
      if (!view && ahead < 0 && !this.wanted.has(at)) missing.push(at);
    });
    if (missing.length && this.send({ type: 'views', episode: found.episode, steps: missing })) missing.forEach((at) => this.wanted.add(at));
  }
}
