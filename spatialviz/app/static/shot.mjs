/* Pictures to keep: of the scene with what stands over it, and of the page. */

import {byId, calls, el, locals, sceneWindow} from './core.mjs';
import {afterDrawing} from './scene.mjs';

/* "demo-000001_000000-mug-left-of-the-laptop.png" */
function fileName(kind) {
  const said = new URLSearchParams(location.search);
  const parts = [said.get('data'), said.get('frame')?.replaceAll('/', '_'), said.get('ask'), kind];
  return parts.filter(Boolean).map(part => part.trim().replace(/[^\p{L}\p{N}_.]+/gu, '-').replace(/^-|-$/g, '')).join('-').slice(0, 120) + '.png';
}

export function saveFile(address, name) {
  const a = el('a');
  a.href = address;
  a.download = name;
  a.click();
}

function saveBlob(blob, name, why = '') {
  const address = URL.createObjectURL(blob);
  saveFile(address, name);
  setTimeout(() => URL.revokeObjectURL(address), 10000);
  calls.toast({title: 'Saved', text: name + why, bad: false});
}

const keep = (canvas, kind) => canvas.toBlob(blob => saveBlob(blob, fileName(kind)), 'image/png');

/* A picture of the server's, into the clipboard; into a file where that is forbidden, as on plain http. */
export async function copyPicture(address, name) {
  const blob = new Blob([await (await fetch(address)).arrayBuffer()], {type: 'image/png'});
  try {
    await navigator.clipboard.write([new ClipboardItem({[blob.type]: blob})]);
    calls.toast({title: 'Copied', text: 'the picture of this answer', bad: false});
  } catch {
    saveBlob(blob, name, ': the browser keeps the clipboard closed here');
  }
}

/* ---- the scene: its own drawing, then what stands over it, as it is laid out */

let wanted = null;
afterDrawing(() => {
  // What WebGL has drawn can be read in the task that has drawn it, and not after it.
  const take = wanted;
  wanted = null;
  take?.();
});

function paint(pen, root, origin) {
  const at = rect => [rect.left - origin.left, rect.top - origin.top, rect.width, rect.height];
  const walk = node => {
    if (node.nodeType === 3) {
      const range = document.createRange();
      range.selectNodeContents(node);
      const [x, y, w, h] = at(range.getBoundingClientRect()), look = getComputedStyle(node.parentElement);
      if (!w || !node.nodeValue.trim()) return;
      pen.fillStyle = look.color;
      pen.font = `${look.fontWeight} ${look.fontSize} ${look.fontFamily}`;
      pen.textBaseline = 'middle';
      pen.fillText(node.nodeValue, x, y + h / 2, w);
      return;
    }
    if (node.nodeType !== 1) return;
    const look = getComputedStyle(node);
    if (look.display === 'none') return;
    if (look.visibility !== 'hidden') {
      const [x, y, w, h] = at(node.getBoundingClientRect());
      if (node instanceof SVGElement) {
        pen.strokeStyle = look.stroke;
        pen.lineWidth = parseFloat(look.strokeWidth);
        const value = name => +node.getAttribute(name);
        pen.beginPath();
        if (node.tagName === 'line') {
          pen.moveTo(value('x1'), value('y1'));
          pen.lineTo(value('x2'), value('y2'));
        } else if (node.tagName === 'circle') pen.arc(value('cx'), value('cy'), value('r'), 0, 7);
        pen.stroke();
      } else {
        pen.beginPath();
        pen.roundRect(x, y, w, h, parseFloat(look.borderTopLeftRadius) || 0);
        pen.fillStyle = look.backgroundColor;
        pen.fill();
        for (const [side, x0, y0, x1, y1] of [['Left', x, y, x, y + h], ['Bottom', x, y + h, x + w, y + h], ['Right', x + w, y, x + w, y + h]]) {
          if (look[`border${side}Style`] === 'none') continue;
          pen.lineWidth = parseFloat(look[`border${side}Width`]);
          pen.strokeStyle = look[`border${side}Color`];
          pen.beginPath();
          pen.moveTo(x0, y0);
          pen.lineTo(x1, y1);
          pen.stroke();
        }
        if (node.tagName === 'IMG') pen.drawImage(node, x, y, w, h);
      }
    }
    for (const child of node.childNodes) walk(child);
  };
  walk(root);
}

function shotOfScene() {
  const scene = sceneWindow()?.__viserMutable;
  if (!scene?.scene) {
    calls.toast({title: 'No picture', text: 'there is no scene yet', bad: true});
    return;
  }
  wanted = () => {
    const drawn = scene.canvas ?? sceneWindow().document.querySelector('canvas'), origin = byId('view').getBoundingClientRect();
    const canvas = el('canvas'), more = drawn.width / origin.width;
    Object.assign(canvas, {width: drawn.width, height: drawn.height});
    const pen = canvas.getContext('2d');
    pen.fillStyle = getComputedStyle(byId('scene')).backgroundColor;
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(drawn, 0, 0);
    pen.scale(more, more);
    for (const name of ['tags', 'scene-low']) paint(pen, byId(name), origin);
    keep(canvas, 'scene');
  };
  scene.requestRender?.();
}

/* ---- the page: the browser asks which tab, and only it can draw frames and canvases as they are */

const HOW = 'The browser\u2019s own way: in Firefox right click, Take Screenshot; in Chrome the developer tools, Ctrl+Shift+P, ' +
  'Capture screenshot; or the key of the system.';

async function shotOfPage() {
  const refused = why => calls.toast({title: 'No picture of the page', text: `${why}. ${HOW}`, bad: true});
  if (!navigator.mediaDevices?.getDisplayMedia) {
    refused('This browser gives none at this address');
    return;
  }
  let stream;
  try {
    stream = await navigator.mediaDevices.getDisplayMedia({preferCurrentTab: true, video: true, audio: false});
  } catch (error) {
    refused(error.name === 'NotAllowedError' ? 'It was not allowed' : error.message);
    return;
  }
  try {
    const video = el('video'), canvas = el('canvas');
    Object.assign(video, {muted: true, srcObject: stream});
    await video.play();
    // The browser's own question leaves the picture first.
    await new Promise(done => setTimeout(done, 400));
    Object.assign(canvas, {width: video.videoWidth, height: video.videoHeight});
    canvas.getContext('2d').drawImage(video, 0, 0);
    keep(canvas, 'page');
  } finally {
    for (const track of stream.getTracks()) track.stop();
  }
}

locals.shot = (_, what) => (what === 'page' ? shotOfPage() : shotOfScene());
