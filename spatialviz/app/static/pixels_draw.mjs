/* Tools and drawing of the editor of pixels: the picture, the mask with what is not answered yet, outlines, the hand's line. */

export const TOOLS = [
  ['select', 'Select', 's', 'Click an object to draw on it.'],
  ['brush', 'Brush', 'b', 'Drag to paint; Shift erases. [ ] or Shift+wheel: size.'],
  ['erase', 'Erase', 'e', 'Drag to erase; Shift paints. [ ] or Shift+wheel: size.'],
  ['polygon', 'Polygon', 'p',
    'Click corners; Enter or double click closes (with Shift: removes); Backspace: one back.'],
  ['rectangle', 'Rectangle', 'r', 'Drag a rectangle; Shift removes. F: only the surface inside it.'],
  ['depth', 'Depth', 'd', 'Click a surface to add it; Shift removes. [ ]: how alike it must be.'],
  ['segment', 'Segment', 'a', 'Click a thing: the segmenter outlines it; Shift removes it.'],
  ['cut', 'Cut', 'c', 'Draw a line across the object, or around a part of it.'],
];
export const HINTS = Object.fromEntries(TOOLS.map(([tool, , , hint]) => [tool, hint]));

const draft = document.createElement('canvas'), outline = document.createElement('canvas');

const sized = (canvas, width, height) => {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
  return canvas.getContext('2d');
};

/* Smallest radius that a stroke is drawn with, in pixels of the picture: at least the pixel below it is hit. */
export const LEAST_RADIUS = 0.71;

/* One gesture, its corners as fractions, into a mask of (w, h) pixels. */
function paint(c, gesture, color, w, h) {
  c.globalCompositeOperation = gesture.add === false ? 'destination-out' : 'source-over';
  c.fillStyle = c.strokeStyle = color;
  c.lineCap = c.lineJoin = 'round';
  const points = gesture.at.map(([x, y]) => [x * w, y * h]);
  c.beginPath();
  if (gesture.do === 'stroke') {
    const radius = Math.max(LEAST_RADIUS, gesture.radius * w);
    if (points.length < 2) {
      c.arc(...points[0], radius, 0, 7);
      c.fill();
    } else {
      c.lineWidth = 2 * radius;
      points.forEach((p, i) => (i ? c.lineTo(...p) : c.moveTo(...p)));
      c.stroke();
    }
  } else if (gesture.do === 'polygon') {
    points.forEach((p, i) => (i ? c.lineTo(...p) : c.moveTo(...p)));
    c.fill('evenodd');
  } else if (gesture.do === 'rectangle') {
    const [a, b] = points;
    c.fillRect(a[0], a[1], b[0] - a[0], b[1] - a[1]);
  }
  c.globalCompositeOperation = 'source-over';
}

/* Draws the editor's state S into its canvas; `over` is where the mouse is, in pixels of the page, or null.
   Returns the object that a click of Select would take, or null. */
export function draw(canvas, S, over) {
  const {data: d, hand, zoom} = S, {w, h} = d;
  const ratio = window.devicePixelRatio || 1, W = canvas.clientWidth, H = canvas.clientHeight;
  // While the window is laid out anew there may be no room.
  if (!W || !H) return null;
  const c = sized(canvas, Math.round(W * ratio), Math.round(H * ratio));
  const X = v => S.x + v * zoom, Y = v => S.y + v * zoom;
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, W, H);
  c.imageSmoothingEnabled = zoom < 2.5;
  c.drawImage(S.image, S.x, S.y, w * zoom, h * zoom);

  const m = sized(draft, w, h);
  m.clearRect(0, 0, w, h);
  if (S.base) m.drawImage(S.base, 0, 0);
  for (const {gesture} of S.pending) paint(m, gesture, d.color, w, h);
  if (hand?.tool === 'brush' || hand?.tool === 'erase') {
    paint(m, {do: 'stroke', at: hand.at, add: hand.add, radius: S.radius}, d.color, w, h);
  }
  c.imageSmoothingEnabled = false;
  c.globalAlpha = 0.42;
  c.drawImage(draft, S.x, S.y, w * zoom, h * zoom);
  c.globalAlpha = 1;

  // The mask's edge: the mask moved by a little to four sides, less the mask.
  // A dark one below it parts it from a picture of its own colour.
  const o = sized(outline, canvas.width, canvas.height);
  o.setTransform(ratio, 0, 0, ratio, 0, 0);
  o.imageSmoothingEnabled = false;
  for (const [by, below] of [[3.2, true], [1.6, false]]) {
    o.clearRect(0, 0, W, H);
    for (const [a, b] of [[by, 0], [-by, 0], [0, by], [0, -by]]) {
      o.drawImage(draft, S.x + a, S.y + b, w * zoom, h * zoom);
    }
    o.globalCompositeOperation = 'destination-out';
    o.drawImage(draft, S.x, S.y, w * zoom, h * zoom);
    o.globalCompositeOperation = 'source-in';
    o.fillStyle = 'rgba(0,0,0,.75)';
    if (below) o.fillRect(0, 0, W, H);
    o.globalCompositeOperation = 'source-over';
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.drawImage(outline, 0, 0);
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  const named = others(c, S, over, ratio, X, Y);
  c.beginPath();
  for (const [x0, y0, x1, y1] of d.edges || []) {
    c.moveTo(X(x0), Y(y0));
    c.lineTo(X(x1), Y(y1));
  }
  for (const [color, width] of [['rgba(0,0,0,.75)', 3.4], [d.color, 1.6]]) {
    Object.assign(c, {strokeStyle: color, lineWidth: width});
    c.stroke();
  }
  line(c, S, over, X, Y);
  return named;
}

/* The outlines of the other objects; the smallest one under the mouse while one is selected. */
function others(c, S, over, ratio, X, Y) {
  const selects = S.tool === 'select';
  let named = null;
  for (const other of S.data.others || []) {
    c.beginPath();
    for (const at of other.lines) {
      for (let i = 0; i < at.length; i += 2) {
        if (i) c.lineTo(X(at[i]), Y(at[i + 1]));
        else c.moveTo(X(at[i]), Y(at[i + 1]));
      }
      c.closePath();
    }
    c.strokeStyle = 'rgba(0,0,0,.5)';
    c.lineWidth = 2;
    c.stroke();
    c.strokeStyle = selects ? 'rgba(255,255,255,.85)' : 'rgba(255,255,255,.4)';
    c.lineWidth = 1;
    c.stroke();
    const under = selects && over && c.isPointInPath(over[0] * ratio, over[1] * ratio);
    if (under && (!named || other.size < named.size)) named = other;
  }
  return named;
}

/* What the hand does now: corners, a cut, a rectangle, the brush. */
function line(c, S, over, X, Y) {
  const {hand, tool, data: {w, h}} = S;
  const at = ([x, y]) => [X(x * w), Y(y * h)];
  const path = points => {
    c.beginPath();
    points.forEach((p, i) => (i ? c.lineTo(...at(p)) : c.moveTo(...at(p))));
  };
  const edge = () => {
    c.strokeStyle = 'rgba(0,0,0,.75)';
    c.lineWidth = 3;
    c.stroke();
    c.strokeStyle = '#fff';
    c.lineWidth = 1.3;
    c.stroke();
  };
  if (S.corners.length) {
    path(S.corners);
    if (over) c.lineTo(...over);
    edge();
    c.fillStyle = '#fff';
    for (const corner of S.corners) {
      const [x, y] = at(corner);
      c.fillRect(x - 2.5, y - 2.5, 5, 5);
    }
  }
  if (hand?.tool === 'cut') {
    path(hand.at);
    edge();
  }
  if (hand?.tool === 'rectangle' && hand.at[1]) {
    const [[ax, ay], [bx, by]] = hand.at.map(at);
    c.beginPath();
    c.rect(ax, ay, bx - ax, by - ay);
    edge();
  }
  if (over && (tool === 'brush' || tool === 'erase')) {
    c.beginPath();
    c.arc(...over, Math.max(LEAST_RADIUS, S.radius * w) * S.zoom, 0, 7);
    edge();
    if ((tool === 'erase') !== S.shift) {
      c.beginPath();
      c.moveTo(over[0] - 4, over[1]);
      c.lineTo(over[0] + 4, over[1]);
      edge();
    }
  }
}
