// Each robot's own eyes: colour, depth and the state image made of them.

import { make, panel, setText } from './element.js';
import { onChange } from './painting.js';
import { depthRange, paintColor, paintDepth, paintView } from './pictures.js';
import { css, paintScale } from './scales.js';
import { clockRuns, episode, gameOn, header, patience, payload, ROBOTS, state, welcome } from './state.js';

const KINDS = {
  color: { title: 'colour', explanation: 'First-person colour picture' },
  depth: { title: 'depth', explanation: 'First-person depth along the optical axis, m' },
  view: { title: 'state image', explanation: 'From above: what this robot sees now, made from its colour and depth' },
};

const PAINT = {
  color: (canvas, key) => paintColor(canvas, payload(key), header(key).width, header(key).height),
  depth: (canvas, key) => paintDepth(canvas, payload(key), header(key).width, header(key).height),
  view: (canvas, key) => paintView(canvas, payload(key), key.split('/')[0]),
};

/** What the colours of state images stand for, whoever looks. */
export function classes() {
  const { palettes, palette_names: names } = welcome();
  return palettes.hider.map((shade, i) => {
    const swatch = make('i.key');
    swatch.style.background = css(shade);
    return make('li', {}, swatch, names[i] ?? '');
  });
}

/** One picture with caption, age and the words for while there is none. */
class Picture {
  constructor(robot, kind) {
    this.key = `${robot}/${kind}`;
    this.kind = kind;
    this.canvas = make(`canvas.picture.${kind === 'color' ? 'smooth' : 'pixels'}`, { role: 'img', 'aria-label': `${robot}: ${KINDS[kind].explanation}` });
    this.age = make('span.age');
    this.empty = make('span.empty', {}, 'waits for a game');
    this.root = make('figure.view', { title: KINDS[kind].explanation }, this.canvas, this.empty,
      make('figcaption', {}, make('span', {}, KINDS[kind].title), this.age));
  }

  paint() {
    const found = header(this.key);
    this.empty.hidden = Boolean(found);
    this.canvas.hidden = !found;
    if (found && welcome()) PAINT[this.kind](this.canvas, this.key);
    this.check();
  }

  /** Dim what is old: nothing new while the clock runs, or no connection. */
  check() {
    const frame = state.frames[this.key];
    if (!frame) {
      this.root.classList.remove('stale');
      setText(this.age, '');
      setText(this.empty, gameOn() ? 'waits for a picture' : 'waits for a game');
      return;
    }
    const age = (performance.now() - frame.arrived) / 1000;
    const old = frame.header.episode !== episode()?.episode;
    const stale = !state.connected || (clockRuns() && age > patience());
    this.root.classList.toggle('stale', stale || old);
    setText(this.age, stale ? `${age.toFixed(0)} s old` : old ? 'last game' : `step ${frame.header.step}`);
  }
}

export class Robots {
  constructor() {
    this.pictures = ROBOTS.flatMap((robot) => Object.keys(KINDS).map((kind) => new Picture(robot, kind)));
    const scale = make('canvas', { 'aria-hidden': 'true' });
    paintScale(scale, 'depth', true);
    this.far = make('span', {}, '');
    this.classes = make('ul.classes', { 'aria-label': 'Colours of a state image' });
    this.names = Object.fromEntries(ROBOTS.map((robot) => [robot, make('b.robot', {}, make('i.key', {}), robot)]));
    const row = (robot) => make('div.robot-row', { role: 'group', 'aria-label': robot }, this.names[robot],
      ...this.pictures.filter((picture) => picture.key.startsWith(robot)).map((picture) => picture.root));
    const { root } = panel('robots', 'What each robot sees', 'Its camera’s colour and depth, and the state image made of them.',
      make('div.robot-rows', {}, ...ROBOTS.map(row)),
      make('div.robot-legends', {},
        make('div.depth-legend', { title: 'Depth along the optical axis' }, make('span', {}, 'depth 0 m'), scale, this.far,
          make('i.key.none'), make('span', {}, 'no return')),
        this.classes));
    this.root = root;
    this.unlisten = [
      ...this.pictures.map((picture) => onChange([picture.key, 'welcome'], () => picture.paint())),
      onChange(['welcome'], () => this.legends()),
      onChange(['episode', 'connected', 'second'], () => this.pictures.forEach((picture) => picture.check())),
    ];
  }

  close() {
    this.unlisten.forEach((stop) => stop());
  }

  legends() {
    if (!welcome()) return;
    const { robot_colors: colors } = welcome();
    setText(this.far, `${depthRange().toFixed(1)} m`);
    this.classes.replaceChildren(...classes());
    for (const robot of ROBOTS) this.names[robot].firstChild.style.background = css(colors[robot]);
  }
}
