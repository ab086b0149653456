// The picture over the scene: in the corner where it hides least of what is answered, chosen once for each answer.

import {byId, calls} from './core.mjs';
import {afterDrawing} from './scene.mjs';
import {overlap, shownTags} from './tags.mjs';

const CORNERS = ['right top', 'right bottom', 'left bottom', 'left top'];
const STILL = 400;  // milliseconds
/* From the edges of the scene: below its tools, above its buttons. */
const EDGE = 12, ROW = 56;

let waiting = true, since = 0, before = '';
calls.answered = () => { waiting = true; };

const place = () => {
  const picture = byId('picture'), {width, height} = picture.getBoundingClientRect();
  const {clientWidth: W, clientHeight: H} = byId('views'), strong = shownTags().filter(tag => tag.strong);
  const boxes = strong.flatMap(tag => [tag.box, tag.rect]).filter(Boolean);
  const now = boxes.map(box => box.map(Math.round)).join();
  if (now !== before) { before = now; since = performance.now(); return; }
  if (!waiting || !boxes.length || !width || performance.now() - since < STILL) return;
  waiting = false;
  const cost = corner => {
    // The hint stands there.
    if (corner === 'left top' && !byId('hint').hidden) return Infinity;
    const x = corner.startsWith('right') ? W - width - EDGE : EDGE;
    const y = corner === 'right top' ? EDGE : corner === 'left top' ? ROW : H - height - ROW;
    const hidden = box => overlap(box, [x, y, x + width, y + height]) / Math.max(1, (box[2] - box[0]) * (box[3] - box[1]));
    return boxes.reduce((sum, box) => sum + hidden(box), 0);
  };
  const costs = CORNERS.map(cost), least = Math.min(...costs);
  picture.dataset.corner = CORNERS[costs.findIndex(one => one <= least + 0.05)];
};
afterDrawing(place);
setInterval(() => { if (waiting) place(); }, 200);
