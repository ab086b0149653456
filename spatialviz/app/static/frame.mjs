/* The scene's frame: loaded once the words stand, with how much of its points is there; where the browser cannot draw it,
the scene is a line that says what to do, and the picture takes its place. */

import {byId, calls, locals, sceneWindow, send} from './core.mjs';

const NONE = 'No 3D scene: this browser has no WebGL 2. Turn on its hardware acceleration.';
const LOST = 'The browser has lost the 3D scene. Draw it again; if that fails, close other tabs that draw.';

const draws = () => {
  const gl = document.createElement('canvas').getContext('webgl2');
  gl?.getExtension('WEBGL_lose_context')?.loseContext();
  return !!gl;
};
const without = words => {
  byId('stage').toggleAttribute('data-sceneless', !!words);
  byId('sceneless').hidden = !words;
  byId('sceneless').firstElementChild.textContent = words;
};
const load = () => {
  const view = byId('view'), able = draws();
  without(able ? '' : NONE);
  if (able && sceneWindow().location.pathname === new URL(view.dataset.path, location.href).pathname) sceneWindow().location.reload();
  else if (able) view.src = view.dataset.path;
};

export const showScene = path => {
  const view = byId('view');
  if (view.dataset.path === path) return;
  view.dataset.path = path;
  // The words are on the screen before viser's client is fetched.
  requestAnimationFrame(() => setTimeout(load));
};
byId('view').addEventListener('load', () => {
  sceneWindow().addEventListener('webglcontextlost', () => without(LOST), true);
  sceneWindow().addEventListener('webglcontextrestored', () => without(''), true);
});
locals.redraw = load;

// ---- what covers the upper right of the scene, as shares of it: the inset picture, or the drawer

let covered = '0,0', telling = 0;
const tell = () => {
  const scene = byId('scene').getBoundingClientRect();
  const parts = ['picture', 'drawer'].map(id => byId(id).getBoundingClientRect())
    .filter(r => r.width && scene.width && r.left > scene.left && r.left < scene.right && r.top < scene.top + scene.height / 3 && r.right > scene.right - 40)
    .map(r => [(scene.right - r.left) / scene.width, Math.min(1, (r.bottom - scene.top) / scene.height)]);
  const now = [0, 1].map(k => Math.max(0, ...parts.map(part => part[k])).toFixed(2)).join();
  if (now !== covered) send('covered', ...(covered = now).split(',').map(Number));
};
const watched = new ResizeObserver(() => {
  clearTimeout(telling);
  telling = setTimeout(tell, 150);
});
for (const id of ['scene', 'picture', 'drawer']) watched.observe(byId(id));

// ---- points: how many of each part of the cloud there are to be, until they are there

let parts = [], waiting = 0;
const there = ([name, count]) => {
  const node = sceneWindow()?.__viserMutable?.nodeRefFromName?.[name];
  return node?.getObjectByProperty('isPoints', true)?.geometry.attributes.position?.count === count;
};
export const isThere = name => parts.some(part => part[0] === name && there(part));
const follow = () => {
  clearTimeout(waiting);
  const sum = some => some.reduce((n, [, count]) => n + count, 0), all = sum(parts), now = sum(parts.filter(there));
  byId('loading').hidden = now === all;
  byId('loading').classList.toggle('none', !now);
  byId('loading').textContent = `${now.toLocaleString('en')} of ${all.toLocaleString('en')} points of this frame`;
  if (now < all) waiting = setTimeout(follow, 100);
};
calls.cloud = counts => {
  parts = Object.entries(counts);
  follow();
};
byId('view').addEventListener('load', follow);
