// The value map over the goals: drawn into the arena, chosen by mouse or keys.

import { button, capital, make, setText } from './element.js';
import { touch } from './painting.js';
import { css, danger, paintScale } from './scales.js';
import { ofThisGame, state, welcome } from './state.js';
import { color } from './theme.js';

const PART = 0.72; // of the goals' spacing is a square's side

export class ValueMap {
  constructor(arena, choose) {
    this.arena = arena;
    this.choose = choose;
    this.chosen = null; // by the keyboard or the mouse
    this.quietUntil = 0;
    this.line = make('p.facts', { 'aria-live': 'polite' }, ' ');
    this.toggle = button('Value map', () => this.show(!state.valuesShown), { 'aria-pressed': 'true', title: 'Show or hide the value map (V)' });
    this.high = make('span', {}, '–');
    this.low = make('span', {}, '–');
    const scale = make('canvas', { 'aria-hidden': 'true' });
    paintScale(scale, 'danger', false);
    const key = (name, text) => make('li', {}, make(`i.key.${name}`, {}), text);
    this.legend = make('div.legend', {},
      make('h3', {}, 'Danger'),
      make('p', {}, 'of each goal: checkpoints at which the hider expects to be caught'),
      make('div.scale', {}, scale, make('div.ends', {},
        make('b', {}, this.high, make('em', {}, 'highest')), make('b', {}, this.low, make('em', {}, 'lowest')))),
      make('ul', {}, key('chosen', 'hider’s goal'), key('clicked', 'your goal'), key('blocked', 'blocked')),
      make('h3', {}, 'Lines'),
      make('ul', {}, key('driven', 'driven'), key('planned', 'planned'), key('asked', 'to your goal'), key('view', 'in view')));
    const { stage } = arena;
    stage.addEventListener('pointermove', (event) => this.point(this.at(event)));
    stage.addEventListener('pointerleave', () => this.describe());
    stage.addEventListener('click', (event) => {
      const goal = this.at(event);
      if (goal !== null) this.pick(goal);
    });
    stage.addEventListener('keydown', (event) => this.key(event));
    for (const kind of ['focus', 'blur']) stage.addEventListener(kind, () => touch('goal'));
  }

  /** The goal under the keyboard, at first the middle one. */
  get focus() {
    return this.chosen ?? Math.floor(welcome().goals.length / 2);
  }

  show(shown) {
    state.valuesShown = shown;
    this.toggle.setAttribute('aria-pressed', String(shown));
    touch('values');
  }

  /** The goal at a mouse event, or null. */
  at(event) {
    if (!welcome()) return null;
    const box = this.arena.stage.getBoundingClientRect();
    const [x, y] = this.arena.metres(event.clientX - box.left, event.clientY - box.top);
    const half = welcome().goal_spacing / 2;
    const goal = welcome().goals.findIndex(([gx, gy]) => Math.abs(gx - x) < half && Math.abs(gy - y) < half);
    return goal < 0 ? null : goal;
  }

  pick(goal) {
    this.chosen = goal;
    this.point(goal);
    this.choose(goal);
  }

  key(event) {
    if (!welcome()) return;
    const columns = Math.round(Math.sqrt(welcome().goals.length));
    const row = Math.floor(this.focus / columns);
    const column = this.focus % columns;
    const move = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
    if (move) {
      const [r, c] = [Math.min(Math.max(row + move[0], 0), columns - 1), Math.min(Math.max(column + move[1], 0), columns - 1)];
      this.chosen = r * columns + c;
      this.point(this.focus);
      touch('goal');
    } else if (event.key === 'Enter') this.choose(this.focus);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  range() {
    const values = (ofThisGame('hider/plan')?.values ?? []).filter((value) => value !== null);
    if (!values.length) return null;
    const [low, high] = [Math.min(...values), Math.max(...values)];
    return [low, Math.max(high, low + 0.01)];
  }

  paint(context) {
    const found = ofThisGame('hider/plan');
    const range = this.range();
    if (!range) return;
    const { arena } = this;
    const side = PART * welcome().goal_spacing * arena.scale;
    const font = Math.min(arena.font, side * 0.42);
    context.font = `${font}px ${getComputedStyle(document.body).fontFamily}`;
    context.textAlign = 'center';
    context.textBaseline = 'middle';
    welcome().goals.forEach(([gx, gy], i) => {
      const [x, y] = [arena.x(gx), arena.y(gy)];
      const value = found.values[i];
      if (value === null) {
        context.strokeStyle = color('quiet');
        context.lineWidth = 1.5;
        const arm = side * 0.16;
        context.beginPath();
        context.moveTo(x - arm, y - arm);
        context.lineTo(x + arm, y + arm);
        context.moveTo(x + arm, y - arm);
        context.lineTo(x - arm, y + arm);
        context.stroke();
        return;
      }
      const part = (value - range[0]) / (range[1] - range[0]);
      context.fillStyle = css(danger(part), 0.92);
      context.fillRect(x - side / 2, y - side / 2, side, side);
      context.strokeStyle = color('box'); // the palest squares are as light as the floor
      context.lineWidth = 1;
      context.strokeRect(x - side / 2, y - side / 2, side, side);
      if (side < 20) return;
      context.fillStyle = part < 0.06 || part > 0.97 ? '#ffffff' : '#111111';
      context.fillText(value.toFixed(1), x, y + 0.5);
    });
  }

  /** Frames around the goal driven to, the goal asked for and, with the keyboard in the map, the goal under it. */
  paintChoice(context) {
    const chosen = ofThisGame('hider/plan')?.goal ?? null;
    this.frame(context, chosen, color('plan'), 3, 0, []);
    if (state.goal !== null && state.goal !== chosen) this.frame(context, state.goal, color('accent'), 3, 0, []);
    if (state.goal !== null && state.goal === chosen) this.frame(context, state.goal, color('accent'), 2, 4, []);
    if (document.activeElement === this.arena.stage) this.frame(context, this.focus, color('text'), 2, 7, [4, 3]);
  }

  frame(context, goal, stroke, width, outset, dash) {
    if (goal === null) return;
    const { arena } = this;
    const [gx, gy] = welcome().goals[goal];
    const side = PART * welcome().goal_spacing * arena.scale + 2 * outset;
    context.setLineDash(dash);
    for (const [line, extra] of [[color('floor'), 3], [stroke, 0]]) {
      context.strokeStyle = line;
      context.lineWidth = width + extra;
      context.strokeRect(arena.x(gx) - side / 2, arena.y(gy) - side / 2, side, side);
    }
    context.setLineDash([]);
  }

  /** Say what a goal is worth, and in the legend what the colours are. */
  point(goal) {
    if (goal === null) {
      this.describe();
      return;
    }
    setText(this.line, `${capital(nameOf(goal))}: ${worthOf(goal)}`);
  }

  describe() {
    if (performance.now() < this.quietUntil) return;
    const range = this.range();
    const found = ofThisGame('hider/plan');
    setText(this.high, range ? range[1].toFixed(2) : '–');
    setText(this.low, range ? range[0].toFixed(2) : '–');
    if (!found) setText(this.line, 'Value map and plan come when the hider has looked and planned (first step of a game).');
    else if (found.goal === null) setText(this.line, 'The hider has no goal.');
    else {
      const checkpoints = Math.floor(found.horizon / found.checkpoint_interval);
      setText(this.line, `Hider’s ${nameOf(found.goal)}: ${worthOf(found.goal)} of ${checkpoints} checkpoints (every `
        + `${found.checkpoint_interval} steps). Planned in ${(found.elapsed * 1000).toFixed(0)} ms.`);
    }
  }
}

/** "goal (0.30, 0.80) m": people know goals by their place. */
export function nameOf(goal) {
  const [x, y] = welcome().goals[goal];
  return `goal (${x.toFixed(2)}, ${y.toFixed(2)}) m`;
}

export function worthOf(goal) {
  const value = ofThisGame('hider/plan')?.values[goal];
  if (value === undefined) return 'no value yet';
  return value === null ? 'blocked' : `danger ${value.toFixed(2)}`;
}
