// Legends of map and charts.

import { colorOf } from "./canvas.js";
import { $, escapeText, setHtml } from "./dom.js";

export function colorOfVehicle({ uavs, ugvs, colors }, name) {
  const flies = uavs.indexOf(name);
  if (flies >= 0) return colorOf(colors.uav, flies);
  const drives = ugvs.indexOf(name);
  return drives >= 0 ? colorOf(colors.ugv, drives) : colors.muted;
}

export function showLegends(store) {
  const { scene, colors, escorts, innerRadius } = store;
  if (!scene || !colors) return;
  const marks = scene.vehicles.map(({ name, flies }) => mark(flies ? "dot" : "square", colorOfVehicle(store, name), name));
  setSwatches($("legend-vehicles"), marks);
  for (const place of document.querySelectorAll(".legend-rs")) place.hidden = !innerRadius;
  for (const place of document.querySelectorAll(".building-key")) place.hidden = !scene.space.buildings.length;
  $("legend-goal").hidden = !scene.vehicles.some(({ goals }) => goals.length);
  setSwatches($("chart-legend"), escorts.map(([uav]) => mark("line", colorOfVehicle(store, uav), uav)));
}

function mark(shape, color, name) {
  return { html: `<span><i class="${shape}"></i>${escapeText(name)}</span>`, color, shape };
}

// Set the colors afterwards: the page's security policy allows no inline style attributes.
function setSwatches(place, marks) {
  setHtml(place, marks.map(({ html }) => html).join(""));
  marks.forEach(({ color, shape }, k) => {
    const { style } = place.children[k].firstChild;
    if (shape === "line") style.borderTopColor = color;
    else style.backgroundColor = color;
  });
}
