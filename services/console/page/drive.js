// Keys, buttons on the page and a gamepad become "this primitive is held".

const KEYS = {
  ArrowUp: 'forward', w: 'forward', ArrowDown: 'backward', s: 'backward',
  ArrowLeft: 'left', a: 'left', ArrowRight: 'right', d: 'right',
};
export const PRIMITIVES = ['forward', 'backward', 'left', 'right'];
const DEAD_ZONE = 0.5;
const START_BUTTON = 9;

export class Drive {
  /**
   * @param {(primitive: string, held: boolean) => void} say
   * @param {() => void} pause the gamepad's start button
   */
  constructor(say, pause) {
    this.say = say;
    this.pause = pause;
    this.held = new Map(PRIMITIVES.map((primitive) => [primitive, new Set()])); // by which sources
    this.padStart = false;
    this.down = (event) => this.key(event, true);
    this.up = (event) => this.key(event, false);
    this.letGo = () => this.release();
    addEventListener('keydown', this.down);
    addEventListener('keyup', this.up);
    addEventListener('blur', this.letGo);
    this.loop = requestAnimationFrame(() => this.poll());
  }

  close() {
    removeEventListener('keydown', this.down);
    removeEventListener('keyup', this.up);
    removeEventListener('blur', this.letGo);
    cancelAnimationFrame(this.loop);
    this.release();
  }

  key(event, held) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.('input, select, textarea')) return;
    const primitive = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!primitive) return;
    event.preventDefault();
    if (!event.repeat) this.set(primitive, `key ${event.code}`, held);
  }

  /** A source (a key, a button, the pad) holds a primitive or lets it go; said when the first comes or the last goes. */
  set(primitive, source, held) {
    const sources = this.held.get(primitive);
    const before = sources.size > 0;
    if (held) sources.add(source);
    else sources.delete(source);
    if (before !== sources.size > 0) this.say(primitive, held);
  }

  release() {
    for (const [primitive, sources] of this.held) {
      if (!sources.size) continue;
      sources.clear();
      this.say(primitive, false);
    }
  }

  /** Say all that is held, and that the rest is not: after a time in which nobody listened. */
  sayAll() {
    for (const [primitive, sources] of this.held) this.say(primitive, sources.size > 0);
  }

  poll() {
    this.loop = requestAnimationFrame(() => this.poll());
    const pads = (navigator.getGamepads?.() ?? []).filter((pad) => pad?.connected);
    if (!pads.length) return;
    const pressed = (index) => pads.some((pad) => pad.buttons[index]?.pressed);
    const axis = (index, sign) => pads.some((pad) => sign * (pad.axes[index] ?? 0) > DEAD_ZONE);
    this.set('forward', 'pad', pressed(12) || axis(1, -1));
    this.set('backward', 'pad', pressed(13) || axis(1, 1));
    this.set('left', 'pad', pressed(14) || axis(0, -1));
    this.set('right', 'pad', pressed(15) || axis(0, 1));
    if (pressed(START_BUTTON) && !this.padStart) this.pause();
    this.padStart = pressed(START_BUTTON);
  }
}
