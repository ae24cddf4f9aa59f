// As far as a camera sees over the floor: rays against boxes and walls.

/** Corners of a box, m: [[x, y] * 4]. */
export function corners(box) {
  const cos = Math.cos(box.heading);
  const sin = Math.sin(box.heading);
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([i, j]) => {
    const across = i * box.half_width;
    const along = j * box.half_depth;
    return [box.x + cos * across - sin * along, box.y + sin * across + cos * along];
  });
}

function distance(x, y, dx, dy, [ax, ay], [bx, by]) {
  const ex = bx - ax;
  const ey = by - ay;
  const cross = dx * ey - dy * ex;
  if (Math.abs(cross) < 1e-12) return Infinity;
  const along = ((ax - x) * ey - (ay - y) * ex) / cross;
  const part = ((ax - x) * dy - (ay - y) * dx) / cross;
  return along > 0 && part >= 0 && part <= 1 ? along : Infinity;
}

/**
 * The area in view, a polygon in m: [[x, y]..], first the camera itself.
 * @param {{x, y, heading}} pose
 * @param {number} field of view, rad
 * @param {Object[]} boxes
 * @param {number} width of the arena, m
 * @param {number} depth of the arena, m
 */
export function viewOf(pose, field, boxes, width, depth) {
  const outlines = [[[0, 0], [width, 0], [width, depth], [0, depth]], ...boxes.map(corners)];
  const edges = outlines.flatMap((outline) => outline.map((corner, i) => [corner, outline[(i + 1) % outline.length]]));
  const angles = [];
  const rays = 60;
  for (let i = 0; i <= rays; i += 1) angles.push(pose.heading + field * (i / rays - 0.5));
  for (const outline of outlines) {
    for (const [x, y] of outline) { // a ray on either side of each corner keeps shadows sharp
      const angle = Math.atan2(y - pose.y, x - pose.x);
      let off = angle - pose.heading;
      off -= 2 * Math.PI * Math.round(off / (2 * Math.PI));
      if (Math.abs(off) < field / 2) angles.push(pose.heading + off - 1e-4, pose.heading + off + 1e-4);
    }
  }
  angles.sort((a, b) => a - b);
  const polygon = [[pose.x, pose.y]];
  for (const angle of angles) {
    const dx = Math.cos(angle);
    const dy = Math.sin(angle);
    let far = 2 * (width + depth); // beyond the walls
    for (const [a, b] of edges) far = Math.min(far, distance(pose.x, pose.y, dx, dy, a, b));
    polygon.push([pose.x + dx * far, pose.y + dy * far]);
  }
  return polygon;
}
