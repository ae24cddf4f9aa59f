// A log that is played back: where it is, how fast, and moving about in it.

import { button, labelled, make, select, setText, setTitle } from './element.js';
import { onChange } from './painting.js';
import { header, replaying, state } from './state.js';

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const PATIENCE = 150; // ms between seeks while the slider is dragged

/** 75.25 s -> "1:15.2" */
export const clock = (seconds) => `${Math.floor(seconds / 60)}:${(Math.floor((seconds % 60) * 10) / 10).toFixed(1).padStart(4, '0')}`;

export class ReplayBar {
  constructor(send) {
    this.send = send;
    this.held = false; // the slider
    this.last = 0;
    this.name = make('span.quiet');
    this.button = button('Pause', () => this.toggle(), { title: 'Play or pause (space)' });
    this.slider = make('input', { type: 'range', min: 0, max: 1, step: 0.05, value: 0, 'aria-label': 'Position in the log, s',
      oninput: () => this.dragged(), onchange: () => this.release() });
    this.place = make('span.value');
    this.speed = select(SPEEDS.map((speed) => [speed, `${speed} ×`]), 1, { 'aria-label': 'Speed', onchange: () => this.send({ type: 'resume', speed: Number(this.speed.value) }) });
    this.root = make('div.bar.replay', { role: 'group', 'aria-label': 'Replay', hidden: true },
      make('h2', { title: 'A recorded log is played on the bus; nobody drives now' }, 'Replay'), this.name, this.button,
      this.slider, this.place, labelled('speed', this.speed, 'Times as fast as it was recorded'));
    this.unlisten = [onChange(['playback', 'welcome', 'second'], () => this.paint())];
  }

  close() {
    this.unlisten.forEach((stop) => stop());
  }

  toggle() {
    this.send({ type: header('playback')?.state === 'playing' ? 'pause' : 'resume' });
  }

  /** Seek to a place, s; `by` moves from where it is. */
  seek(position) {
    const { duration } = header('playback');
    this.send({ type: 'seek', position: Math.min(Math.max(position, 0), duration) });
  }

  by(seconds) {
    if (replaying()) this.seek(this.position() + seconds);
  }

  dragged() {
    this.held = true;
    setText(this.place, `${clock(Number(this.slider.value))} / ${clock(header('playback').duration)}`);
    if (performance.now() - this.last > PATIENCE) {
      this.last = performance.now();
      this.seek(Number(this.slider.value));
    }
  }

  release() {
    this.held = false;
    this.seek(Number(this.slider.value));
  }

  /** Twice a second the bus says where the log is; between, it is counted on. */
  position() {
    const found = header('playback');
    const passed = found.state === 'playing' && state.connected ? (performance.now() - state.frames.playback.arrived) / 1000 : 0;
    return Math.min(found.position + Math.min(passed, 1) * found.speed, found.duration);
  }

  paint() {
    const found = header('playback');
    this.root.hidden = !found;
    if (!found) return;
    setText(this.name, found.log);
    setTitle(this.name, found.log);
    setText(this.button, found.state === 'playing' ? '❚❚ Pause' : found.state === 'ended' ? '▶ Again' : '▶ Play');
    if (document.activeElement !== this.speed) this.speed.value = String(found.speed);
    this.slider.max = found.duration;
    if (this.held) return;
    this.slider.value = this.position();
    setText(this.place, `${clock(this.position())} / ${clock(found.duration)} min:s${found.state === 'ended' ? ' · end' : ''}`);
  }
}
