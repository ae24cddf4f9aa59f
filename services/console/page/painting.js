// Draws what changed, once a display frame; remembers when what was painted.

const RING = 2000;

/** [key, stamp as string, Date.now() after the draw] of the last frames painted: for measuring bus to pixel. */
export const painted = [];

const painters = new Map(); // key -> Set of functions
const changed = new Map(); // key -> stamp
let asked = false;

/** Call `paint` in the display frame after any of `keys` changed. Returns a function that takes it off again. */
export function onChange(keys, paint) {
  for (const key of keys) {
    if (!painters.has(key)) painters.set(key, new Set());
    painters.get(key).add(paint);
  }
  return () => keys.forEach((key) => painters.get(key).delete(paint));
}

/** Say that something changed. */
export function touch(key, stamp = '') {
  changed.set(key, stamp);
  if (!asked) {
    asked = true;
    requestAnimationFrame(draw);
  }
}

function draw() {
  asked = false;
  const now = [...changed];
  changed.clear();
  const jobs = new Set();
  for (const [key] of now) for (const paint of painters.get(key) ?? []) jobs.add(paint);
  for (const paint of jobs) {
    try {
      paint();
    } catch (error) {
      console.error(error); // one broken panel must not stop the others
    }
  }
  const at = Date.now();
  for (const [key, stamp] of now) if (stamp) painted.push([key, stamp, at]);
  if (painted.length > RING) painted.splice(0, painted.length - RING);
}
