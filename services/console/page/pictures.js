// Pixels of a frame into a canvas. Canvases keep their picture's own size; CSS scales them.

import { welcome } from './state.js';
import { depthTable, pack } from './scales.js';

const buffers = new WeakMap();

function buffer(canvas, width, height) {
  let found = buffers.get(canvas);
  if (!found || found.image.width !== width || found.image.height !== height) {
    canvas.width = width;
    canvas.height = height;
    const context = canvas.getContext('2d', { alpha: false });
    const image = context.createImageData(width, height);
    found = { context, image, pixels: new Uint32Array(image.data.buffer) };
    buffers.set(canvas, found);
  }
  return found;
}

function show({ context, image }) {
  context.putImageData(image, 0, 0);
}

/** @param {Uint8Array} rgb [height, width, 3] */
export function paintColor(canvas, rgb, width, height) {
  const target = buffer(canvas, width, height);
  const { pixels } = target;
  for (let i = 0, j = 0; i < pixels.length; i += 1, j += 3) pixels[i] = (0xff000000 | rgb[j + 2] << 16 | rgb[j + 1] << 8 | rgb[j]) >>> 0;
  show(target);
}

/** @param {Uint8Array} bytes uint16 LE [height, width], mm. */
export function paintDepth(canvas, bytes, width, height) {
  const target = buffer(canvas, width, height);
  const table = depthTable(depthRange());
  const { pixels } = target;
  for (let i = 0, j = 0; i < pixels.length; i += 1, j += 2) pixels[i] = table[bytes[j] | bytes[j + 1] << 8];
  show(target);
}

/** m at the far end of the depth legend: the table's diagonal. */
export const depthRange = () => Math.ceil(welcome().size * Math.SQRT2 * 10) / 10;

/** @param {Uint8Array} indices [size, size] palette indices, row 0 far. */
export function paintView(canvas, indices, robot) {
  const size = Math.sqrt(indices.length);
  const target = buffer(canvas, size, size);
  const colors = welcome().palettes[robot].map(pack); // a robot has one colour, whoever looks
  const { pixels } = target;
  for (let i = 0; i < pixels.length; i += 1) pixels[i] = colors[indices[i]] ?? 0xff808080;
  show(target);
}

/**
 * A predicted seeker view, RGB [size, size, 3] in the network's colours: a seeker's own disc is green, the hider red. Shown with
 * the robots' own colours, blends in between, as `view_for_people` of vantage/perception/palette.py does.
 */
export function paintPredicted(canvas, rgb) {
  const size = Math.sqrt(rgb.length / 3);
  const target = buffer(canvas, size, size);
  const { pixels } = target;
  const { hider, seeker } = welcome().robot_colors;
  for (let i = 0, j = 0; i < pixels.length; i += 1, j += 3) {
    const [red, green, blue] = [rgb[j + 1] / 255, rgb[j] / 255, rgb[j + 2] / 255];
    const ofHider = green * (1 - red) * (1 - blue);
    const ofSeeker = red * (1 - green) * (1 - blue);
    const part = (own, k) => Math.round(255 * own + ofHider * (hider[k] - (k === 1 ? 255 : 0)) + ofSeeker * (seeker[k] - (k === 0 ? 255 : 0)));
    pixels[i] = pack([part(red, 0), part(green, 1), part(blue, 2)]);
  }
  show(target);
}

/** Leave a canvas empty: nothing came yet. */
export function blank(canvas) {
  buffers.delete(canvas);
  canvas.width = canvas.width; // eslint-disable-line no-self-assign
}
