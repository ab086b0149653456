/* Names that follow what they name in the scene: placed over its frame after each of its drawings.

A tag never covers what it names, nor another tag, nor leaves the scene; where it stands apart a line leads to it. */

import {calls, el, sceneHost, sceneWindow} from './core.mjs';
import {SVG, afterDrawing, project, times, viewMatrix} from './scene.mjs';

/* Of those without a role. */
const MOST_WEAK = 8;
/* In pixels from the box. */
const GAP = 6, RINGS = [GAP, 26, 46], FARTHEST = 48;
/* A line leads from tags that stand farther from the lines of their box. */
const LEAD_FROM = GAP + 2;
/* What places cost, in pixels squared of covered strong boxes: a ring farther out; a place other than the last; a pixel
between tag and lines of the box. */
const RING_COST = 400, MOVE_COST = 300, SIDE_COST = 15, APART_COST = 20;
/* A weak tag covers no more than this share of itself of a strong box, save of one that takes half of the scene. */
const COVERED = 0.15;
export const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map(k => [k & 1 ? 1 : -1, k & 2 ? 1 : -1, k & 4 ? 1 : -1]);
export const BOX_EDGES = CORNERS.flatMap((_, a) => [1, 2, 4].filter(bit => !(a & bit)).map(bit => [a, a | bit]));

/* ---- colours */

const channel = v => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);

/* WCAG's luminance of "#rrggbb". */
export function luminance(color) {
  const [r, g, b] = [1, 3, 5].map(at => channel(parseInt(color.slice(at, at + 2), 16) / 255));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

/* Black or white, whichever is read better on a colour: never under 4.58 to 1. */
export function inkOn(color) {
  const l = luminance(color);
  return (l + 0.05) / 0.05 > 1.05 / (l + 0.05) ? '#000' : '#fff';
}

/* ---- geometry: [x0, y0, x1, y1] in pixels of the host */

export const overlap = (a, b) => Math.max(0, Math.min(a[2], b[2]) - Math.max(a[0], b[0]))
  * Math.max(0, Math.min(a[3], b[3]) - Math.max(a[1], b[1]));
const within = (v, low, high) => Math.max(low, Math.min(high, v));

/* What of a line is in the scene: its ends, or null. */
function clipped([ax, ay], [bx, by], W, H) {
  let first = 0, last = 1;
  for (const [from, step, most] of [[ax, bx - ax, W], [ay, by - ay, H]]) {
    if (!step && (from < 0 || from > most)) return null;
    if (!step) continue;
    const [a, b] = [-from / step, (most - from) / step];
    first = Math.max(first, Math.min(a, b));
    last = Math.min(last, Math.max(a, b));
  }
  const at = along => [ax + along * (bx - ax), ay + along * (by - ay)];
  return first <= last ? [at(first), at(last)] : null;
}

/* The point of lines that is nearest to a point; null without any. */
function nearest(edges, x, y) {
  let best = null, least = Infinity;
  for (const [[ax, ay], [bx, by]] of edges) {
    const dx = bx - ax, dy = by - ay, along = within(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1), 0, 1);
    const px = ax + along * dx, py = ay + along * dy, far = (px - x) ** 2 + (py - y) ** 2;
    if (far < least) [best, least] = [[px, py], far];
  }
  return best;
}

/* From lines to a tag: the nearest point of them, and that of the tag; null without any. */
function leader([x0, y0, x1, y1], edges) {
  const from = nearest(edges, (x0 + x1) / 2, (y0 + y1) / 2);
  return from && [from, [within(from[0], x0, x1), within(from[1], y0, y1)]];
}
function apart(rect, edges) {
  const ends = leader(rect, edges);
  return ends ? Math.hypot(ends[0][0] - ends[1][0], ends[0][1] - ends[1][1]) : 0;
}

/* The places around a box for a tag of (w, h): eight on the inner ring with four beside its outermost corners, four on each
farther one. */
function candidates([x0, y0, x1, y1], ends, w, h, W, H) {
  const found = [];
  RINGS.forEach((gap, ring) => {
    const midX = (x0 + x1 - w) / 2, midY = (y0 + y1 - h) / 2;
    const above = y0 - gap - h, below = y1 + gap, left = x0 - gap - w, right = x1 + gap;
    const sides = [[midX, above], [right, midY], [left, midY], [midX, below]];
    const corners = [[x1 - w / 3, above], [x0 - (2 * w) / 3, above], [x1 - w / 3, below], [x0 - (2 * w) / 3, below]];
    const outermost = ends.map(([x, y], side) => [[x - w / 2, above], [right, y - h / 2], [left, y - h / 2], [x - w / 2, below]][side]);
    [...sides, ...(ring ? [] : [...outermost, ...corners])].forEach(([x, y], side) => {
      // Along its side a tag may slide to stay in the scene, so that it still stands beside its box.
      const vertical = [1, 2, 5, 6].includes(side);
      const tx = vertical ? x : within(x, 2, W - w - 2), ty = vertical ? within(y, 2, H - h - 2) : y;
      found.push({ring, side, rect: [tx, ty, tx + w, ty + h]});
    });
  });
  return found;
}

/* The place that covers least, on a grid over a box and what is near it: for a strong tag without a place around it. */
function anywhere({box: [x0, y0, x1, y1], w, h, edges}, W, H, covered) {
  let best = null, least = Infinity;
  const left = within(x0 - FARTHEST - w, 2, W - w - 2), right = within(x1 + FARTHEST, 2, W - w - 2);
  const top = within(y0 - FARTHEST - h, 2, H - h - 2), bottom = within(y1 + FARTHEST, 2, H - h - 2);
  for (let y = top; y <= bottom; y += h / 2) {
    for (let x = left; x <= right; x += 12) {
      const rect = [x, y, x + w, y + h], far = apart(rect, edges);
      const cost = far > FARTHEST ? Infinity : covered(rect) + APART_COST * far;
      if (cost < least) [best, least] = [rect, cost];
    }
  }
  return best;
}

/* Chooses where tags stand: items ({box, edges, ends, w, h, strong, place}) in the order in which they may choose, changed in
   place: `rect` (null: hidden) and `place`, the candidate that was taken, which is kept while it is free. */
export function arrange(items, W, H, taken = []) {
  const put = [...taken], strong = items.filter(item => item.strong).map(item => item.box);
  const kept = strong.filter(box => overlap(box, [0, 0, W, H]) < (W * H) / 2);
  for (const item of items) {
    const free = rect => rect[0] >= 0 && rect[1] >= 0 && rect[2] <= W && rect[3] <= H
      && !overlap(rect, item.box) && put.every(other => !overlap(rect, other));
    let least = Infinity;
    item.rect = null;
    candidates(item.box, item.ends, item.w, item.h, W, H).forEach(({ring, side, rect}, place) => {
      const covers = box => overlap(rect, box) > COVERED * item.w * item.h;
      if (!free(rect) || (!item.strong && kept.some(covers))) return;
      const far = apart(rect, item.edges);
      if (far > FARTHEST) return;
      let cost = ring * RING_COST + side * SIDE_COST + APART_COST * Math.max(0, far - GAP) + (place === item.place ? 0 : MOVE_COST);
      for (const box of strong) if (box !== item.box) cost += overlap(rect, box);
      if (cost >= least) return;
      least = cost;
      item.rect = rect;
      item.next = place;
    });
    if (!item.rect && item.strong) {
      const over = (rect, boxes) => boxes.reduce((sum, other) => sum + overlap(rect, other), 0);
      item.rect = anywhere(item, W, H, rect => 100 * over(rect, put) + over(rect, kept));
      item.next = -1;
    }
    item.place = item.rect ? item.next : -1;
    if (item.rect) put.push([item.rect[0] - 1, item.rect[1] - 1, item.rect[2] + 1, item.rect[3] + 1]);
  }
}

/* ---- projection */

/* Where the box of a tag is drawn; whether any of it is in the scene. */
function look(tag, view, W, H) {
  const node = tag.nodes[tag.node];
  if (!node?.matrixWorld) return false;
  node.updateWorldMatrix(true, false);
  const m = times(view, node.matrixWorld.elements), {extent, R} = tag;
  const middle = project(m, 0, 0, 0, W, H);
  if (!middle) return false;
  tag.corners = CORNERS.map(signs => {
    const along = signs.map((sign, k) => sign * extent[k]), [x, y, z] = [0, 3, 6].map(row => along.reduce((sum, v, k) => sum + R[row + k] * v, 0));
    return project(m, x, y, z, W, H) ?? middle;
  });
  tag.edges = BOX_EDGES.map(([i, j]) => clipped(tag.corners[i], tag.corners[j], W, H)).filter(Boolean);
  const points = tag.edges.length ? tag.edges.flat() : [middle];
  // Topmost, rightmost, leftmost, lowest.
  tag.ends = [p => p[1], p => -p[0], p => p[0], p => -p[1]].map(of => points.reduce((a, b) => (of(b) < of(a) ? b : a)));
  const xs = tag.corners.map(p => p[0]), ys = tag.corners.map(p => p[1]);
  tag.box = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  tag.far = middle[2];
  return tag.box[0] < W && tag.box[2] > 0 && tag.box[1] < H && tag.box[3] > 0;
}

/* ---- elements */

let layer = null, lines = null, tags = [], size = [0, 0];

function layers() {
  if (layer?.isConnected) return;
  layer = el('div', 'scene-tags');
  lines = document.createElementNS(SVG, 'svg');
  layer.setAttribute('aria-hidden', 'true');
  layer.append(lines);
  const host = sceneHost();
  host.prepend(layer);
  new ResizeObserver(() => {
    size = [host.clientWidth, host.clientHeight];
    place();
  }).observe(host);
}

/* `list`: {node, text, detail, color, strong, extent, R, mark, right, dashed}, half sizes and rotation of a box around
   the node. */
calls.tags = list => {
  layers();
  const known = new Map(tags.map(tag => [tag.node, tag])), texts = some => some.filter(tag => tag.strong).map(tag => tag.text).join('|');
  // Of another answer they choose their places anew.
  const another = texts(tags) !== texts(list);
  tags = list.map(one => {
    const old = known.get(one.node);
    const same = old && ['text', 'detail', 'color', 'strong', 'mark', 'right', 'dashed'].every(name => old[name] === one[name]);
    const tag = {shown: false, ...old, place: another ? -1 : old?.place ?? -1, ...one};
    if (!same) [tag.div, tag.line, tag.w] = [...element(one), 0];
    return tag;
  });
  layer.replaceChildren(lines, ...tags.map(tag => tag.div));
  lines.replaceChildren(...tags.map(tag => tag.line));
  // All are measured before any is moved: one layout.
  for (const tag of tags) if (!tag.w) [tag.w, tag.h, tag.at] = [tag.div.offsetWidth, tag.div.offsetHeight, ''];
  place();
};

function element({text, detail, color, strong, mark, right, dashed}) {
  const div = el('div', `tag${strong ? '' : ' weak'}${dashed ? ' dashed' : ''}`), line = document.createElementNS(SVG, 'line');
  div.style.setProperty('--c', color);
  div.style.setProperty('--ink', inkOn(color));
  if (mark) div.append(el('b', '', mark), ' ');
  div.append(text + (right ? ' \u2713' : ''));
  if (detail) div.append(' ', el('i', '', detail));
  line.style.stroke = color;
  return [div, line];
}

function hide(tag) {
  if (tag.at === 'hidden') return;
  tag.at = 'hidden';
  tag.div.style.visibility = tag.line.style.visibility = 'hidden';
}

function stand(tag) {
  const [x0, y0] = tag.rect, at = `translate(${Math.round(x0)}px, ${Math.round(y0)}px)`;
  const ends = leader(tag.rect, tag.edges), leads = apart(tag.rect, tag.edges) > LEAD_FROM;
  if (tag.at !== at) {
    tag.at = at;
    tag.div.style.transform = at;
    tag.div.style.visibility = 'visible';
  }
  tag.line.style.visibility = leads ? 'visible' : 'hidden';
  if (!leads) return;
  const [[bx, by], [tx, ty]] = ends;
  for (const [name, value] of [['x1', tx], ['y1', ty], ['x2', bx], ['y2', by]]) {
    tag.line.setAttribute(name, value.toFixed(1));
  }
}

/* What else stands over the scene: tools, legend with scale, buttons, the inset picture. */
export function standing() {
  const {left, top} = layer.getBoundingClientRect();
  return [...document.querySelectorAll('#scene-tools>*, #hint, #scene-low, #scene-buttons>*, #picture, #drawer')].map(e => e.getBoundingClientRect())
    .filter(r => r.width).map(r => [r.left - left - 2, r.top - top - 2, r.right - left + 2, r.bottom - top + 2]);
}

function place() {
  const view = viewMatrix(), [W, H] = size;
  if (!tags.length || !W) return;
  const nodes = sceneWindow()?.__viserMutable?.nodeRefFromName;
  if (!view || !nodes) {
    tags.forEach(hide);
    return;
  }
  const seen = tags.filter(tag => look(Object.assign(tag, {nodes}), view, W, H));
  // One that is shown stays so until another is clearly nearer.
  const nearness = tag => tag.far * (tag.shown ? 0.9 : 1);
  const weak = seen.filter(tag => !tag.strong).sort((a, b) => nearness(a) - nearness(b)).slice(0, MOST_WEAK);
  const chosen = new Set([...seen.filter(tag => tag.strong), ...weak]);
  // They choose in an order that does not change while the camera turns.
  const shown = tags.filter(tag => chosen.has(tag)).sort((a, b) => b.strong - a.strong);
  arrange(shown, W, H, standing());
  for (const tag of tags) {
    tag.shown = chosen.has(tag) && tag.rect !== null;
    if (tag.shown) stand(tag);
    else hide(tag);
  }
}

afterDrawing(place);

/* The tags that are shown, with the boxes that they name and how far from their lines: for what checks the page. */
export const shownTags = () => tags.filter(tag => tag.shown)
  .map(({text, detail, strong, rect, box, edges}) => ({text, detail, strong, rect, box, apart: apart(rect, edges)}));
