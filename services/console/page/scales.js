// Colour scales: one for danger, one for depth. Both are told apart by the colour-blind, and always stand beside numbers.

// Brewer's RdYlBu, from the lowest danger (blue) to the highest (red), as in the figures of docs/.
const DANGER = [[69, 117, 180], [145, 191, 219], [224, 243, 248], [255, 255, 191], [254, 224, 144], [252, 141, 89], [215, 48, 39]];
// Viridis: even in lightness, near is bright.
const NEAR_TO_FAR = [[253, 231, 37], [144, 215, 67], [53, 183, 121], [33, 145, 140], [49, 104, 142], [68, 57, 131], [68, 1, 84]];

function between(table, part) {
  const place = Math.min(Math.max(part, 0), 1) * (table.length - 1);
  const low = Math.min(Math.floor(place), table.length - 2);
  return table[low].map((value, i) => Math.round(value + (table[low + 1][i] - value) * (place - low)));
}

export const css = ([red, green, blue], alpha = 1) => `rgb(${red} ${green} ${blue} / ${alpha})`;

/** @param {number} part 0 = lowest, 1 = highest. Returns [r, g, b]. */
export const danger = (part) => between(DANGER, part);

/** Little-endian RGBA of [r, g, b]. */
export const pack = ([red, green, blue]) => (255 << 24 | blue << 16 | green << 8 | red) >>> 0;

const tables = new Map();

/** Uint32Array [65536]: RGBA of each depth in mm; 0 = no return is black. @param {number} range m. */
export function depthTable(range) {
  if (!tables.has(range)) {
    const table = new Uint32Array(65536);
    const far = Math.round(range * 1000);
    for (let mm = 0; mm < 65536; mm += 1) table[mm] = pack(between(NEAR_TO_FAR, mm / far));
    table[0] = pack([0, 0, 0]);
    tables.set(range, table);
  }
  return tables.get(range);
}

/** Paint a scale into a canvas, `horizontal` from left to right, else from bottom to top. */
export function paintScale(canvas, name, horizontal) {
  const table = name === 'danger' ? DANGER : NEAR_TO_FAR;
  canvas.width = horizontal ? 128 : 1;
  canvas.height = horizontal ? 1 : 128;
  const context = canvas.getContext('2d');
  for (let i = 0; i < 128; i += 1) {
    context.fillStyle = css(between(table, i / 127));
    if (horizontal) context.fillRect(i, 0, 1, 1);
    else context.fillRect(0, 127 - i, 1, 1);
  }
}
