// The arena from above, in three layers: floor and what is in view; the value map; obstacles, paths and robots.

import { corners, viewOf } from './visibility.js';
import { make, panel, setText } from './element.js';
import { css } from './scales.js';
import { onChange, touch } from './painting.js';
import { header, ofThisGame, plan, ROBOTS, state, welcome } from './state.js';
import { color } from './theme.js';
import { ValueMap } from './value_map.js';

const PATIENCE = 5000; // ms for a line to be read

export class Arena {
  /** @param {(goal: number) => void} choose called with the goal that was clicked. */
  constructor(choose) {
    [this.base, this.middle, this.top] = [1, 2, 3].map(() => make('canvas', { 'aria-hidden': 'true' }));
    this.stage = make('div.stage', {
      tabindex: '0', role: 'application', 'aria-roledescription': 'map',
      'aria-label': 'Arena from above. Arrow keys move between goals, Enter asks what the seeker would see on the way there.',
    }, this.base, this.middle, this.top);
    this.values = new ValueMap(this, choose);
    const { root, tools } = panel('arena', 'Arena', 'Click a square: what would the seeker see on the way there?',
      make('div.arena-body', {}, this.stage, this.values.legend), this.values.line);
    tools.append(this.values.toggle);
    this.root = root;
    this.scale = 0;
    const poses = ROBOTS.map((robot) => `${robot}/pose`);
    this.unlisten = [
      onChange(['welcome', 'theme', 'size', 'layout', ...poses], () => this.paintBase()),
      onChange(['welcome', 'theme', 'size', 'layout', 'hider/plan', 'values', 'goal', 'episode'], () => this.paintValues()),
      onChange(['welcome', 'theme', 'size', 'layout', 'hider/plan', 'prediction', 'goal', 'episode', 'playback', 'driven',
        ...poses, ...ROBOTS.map((robot) => `${robot}/track`)], () => this.paintTop()),
    ];
    this.observer = new ResizeObserver(() => this.fit());
    this.observer.observe(this.stage);
  }

  close() {
    this.unlisten.forEach((stop) => stop());
    this.observer.disconnect();
  }

  size() {
    const layout = header('layout');
    const { size } = welcome();
    return [layout?.width ?? size, layout?.depth ?? size];
  }

  fit() {
    const ratio = devicePixelRatio;
    for (const canvas of [this.base, this.middle, this.top]) {
      canvas.width = Math.round(this.stage.clientWidth * ratio);
      canvas.height = Math.round(this.stage.clientHeight * ratio);
    }
    this.font = 0.86 * parseFloat(getComputedStyle(document.body).fontSize);
    touch('size');
  }

  /** Set up a layer: drawing is in CSS pixels; `x(m)` and `y(m)` convert. */
  begin(canvas) {
    const context = canvas.getContext('2d');
    const ratio = devicePixelRatio;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [width, height] = [canvas.width / ratio, canvas.height / ratio];
    context.clearRect(0, 0, width, height);
    const [across, along] = this.size();
    const [left, below, edge] = [this.font * 3.4, this.font * 2.4, this.font * 0.7];
    this.scale = Math.max(1, Math.min((width - left - edge) / across, (height - below - edge) / along));
    this.left = left + (width - left - edge - across * this.scale) / 2;
    this.bottom = edge + along * this.scale + (height - below - edge - along * this.scale) / 2;
    context.font = `${this.font}px ${getComputedStyle(document.body).fontFamily}`;
    context.lineJoin = 'round';
    return context;
  }

  x = (metres) => this.left + metres * this.scale;
  y = (metres) => this.bottom - metres * this.scale;
  /** Metres of a point in CSS pixels of the stage. */
  metres = (px, py) => [(px - this.left) / this.scale, (this.bottom - py) / this.scale];

  paintBase() {
    if (!this.base.width || !welcome()) return;
    const context = this.begin(this.base);
    const [width, depth] = this.size();
    context.fillStyle = color('floor');
    context.fillRect(this.x(0), this.y(depth), width * this.scale, depth * this.scale);
    for (const [robot, pose] of this.poses()) this.fieldOfView(context, robot, pose);
    this.grid(context, width, depth);
  }

  paintValues() {
    if (!this.middle.width || !welcome()) return;
    const context = this.begin(this.middle);
    if (state.valuesShown) this.values.paint(context);
    this.values.describe();
  }

  /** [robot, its pose] of those that were seen. */
  poses() {
    return ROBOTS.map((robot) => [robot, header(`${robot}/pose`)]).filter(([, pose]) => pose);
  }

  grid(context, width, depth) {
    context.fillStyle = color('quiet');
    context.lineWidth = 1;
    context.textBaseline = 'middle';
    const tenths = (length) => Array.from({ length: Math.floor(length * 10 + 1e-6) + 1 }, (_, i) => i / 10);
    const every = this.scale * 0.1 < this.font * 2.4 ? 2 : 1;
    for (const metres of tenths(width)) {
      context.strokeStyle = color('grid');
      context.strokeRect(this.x(metres), this.y(depth), 0, depth * this.scale);
      context.textAlign = 'center';
      if (Math.round(metres * 10) % every === 0) context.fillText(metres.toFixed(1), this.x(metres), this.bottom + this.font * 0.85);
    }
    for (const metres of tenths(depth)) {
      context.strokeRect(this.x(0), this.y(metres), width * this.scale, 0);
      context.textAlign = 'right';
      if (Math.round(metres * 10) % every === 0) context.fillText(metres.toFixed(1), this.left - this.font * 0.45, this.y(metres));
    }
    context.textAlign = 'center';
    context.fillText('x [m]', this.x(width / 2 + 0.05), this.bottom + this.font * 1.85);
    context.save();
    context.translate(this.left - this.font * 2.75, this.y(depth / 2 + 0.05));
    context.rotate(-Math.PI / 2);
    context.fillText('y [m]', 0, 0);
    context.restore();
    context.strokeStyle = color('text');
    context.lineWidth = 2;
    context.strokeRect(this.x(0), this.y(depth), width * this.scale, depth * this.scale);
  }

  paintTop() {
    if (!this.top.width || !welcome()) return;
    const context = this.begin(this.top);
    for (const box of ofThisGame('layout')?.obstacles ?? header('layout')?.obstacles ?? []) this.box(context, box);
    this.routes(context);
    for (const [robot, pose] of this.poses()) this.robot(context, robot, pose, header(`${robot}/track`));
    this.values.paintChoice(context);
  }

  trace(context, points) {
    context.beginPath();
    points.forEach(([x, y], i) => (i ? context.lineTo(this.x(x), this.y(y)) : context.moveTo(this.x(x), this.y(y))));
  }

  box(context, box) {
    this.trace(context, corners(box));
    context.closePath();
    context.fillStyle = color('box');
    context.strokeStyle = color('text');
    context.lineWidth = 1.5;
    context.fill();
    context.stroke();
  }

  fieldOfView(context, robot, pose) {
    const { field_of_view: usual, robot_colors: colors } = welcome();
    const picture = header(`${robot}/depth`); // says what its own camera sees
    const field = picture ? 2 * Math.atan(picture.width / (2 * picture.intrinsics.fx)) : usual;
    const [width, depth] = this.size();
    this.trace(context, viewOf(pose, field, header('layout')?.obstacles ?? [], width, depth));
    context.closePath();
    context.fillStyle = css(colors[robot], 0.2);
    context.strokeStyle = css(colors[robot], 0.75);
    context.lineWidth = 1;
    context.setLineDash(robot === 'seeker' ? [4, 3] : []);
    context.fill();
    context.stroke();
    context.setLineDash([]);
  }

  routes(context) {
    const intended = plan();
    const points = [];
    for (let i = 0; intended && i < intended.path.length; i += 3) points.push([intended.path[i], intended.path[i + 1]]);
    this.route(context, points, color('plan'), [2, 5], 3);
    const prediction = ofThisGame('prediction');
    if (prediction && prediction.goal !== intended?.header.goal) this.route(context, prediction.path, color('accent'), [7, 5], 2.5);
    for (const robot of ROBOTS) {
      const driven = state.paths[robot].map(([, x, y]) => [x, y]);
      this.route(context, driven, css(welcome().robot_colors[robot]), [], 3);
    }
  }

  route(context, points, stroke, dash, width) {
    if (points.length < 2) return;
    context.lineCap = 'round';
    context.setLineDash(dash);
    this.trace(context, points);
    context.strokeStyle = color('floor');
    context.lineWidth = width + 2.5;
    context.stroke();
    context.strokeStyle = stroke;
    context.lineWidth = width;
    context.stroke();
    context.setLineDash([]);
    context.lineCap = 'butt';
  }

  robot(context, robot, pose, track) {
    const { robot_radius: radius, robot_colors: colors } = welcome();
    const size = radius * this.scale;
    const [x, y] = [this.x(pose.x), this.y(pose.y)];
    context.beginPath();
    context.arc(x, y, size, 0, 2 * Math.PI);
    context.fillStyle = css(colors[robot]);
    context.strokeStyle = color('edge');
    context.lineWidth = 2;
    context.fill();
    context.stroke();
    this.trace(context, [[pose.x, pose.y], [pose.x + radius * Math.cos(pose.heading), pose.y + radius * Math.sin(pose.heading)]]);
    context.lineWidth = 3;
    context.stroke();
    context.font = `700 ${Math.max(10, size * 0.8)}px ${getComputedStyle(document.body).fontFamily}`;
    context.textAlign = 'center';
    context.textBaseline = 'middle';
    context.fillStyle = color('edge');
    const back = 0.42 * size;
    context.fillText(robot[0].toUpperCase(), x - back * Math.cos(pose.heading), y + back * Math.sin(pose.heading));
    if (!track) return;
    context.beginPath(); // where the overhead camera sees it now, between steps
    context.arc(this.x(track.x), this.y(track.y), size + 3, 0, 2 * Math.PI);
    context.setLineDash(track.seen ? [] : [3, 3]);
    context.strokeStyle = css(colors[robot]);
    context.lineWidth = 2;
    context.stroke();
    context.setLineDash([]);
  }

  /** Say something that stays for a while. */
  say(text) {
    setText(this.values.line, text);
    this.values.quietUntil = performance.now() + PATIENCE;
  }
}
