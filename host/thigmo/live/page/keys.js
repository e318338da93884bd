// The list of keys, which `?` shows and hides.

import { zoom, unzoom } from "./charts.js";
import { $ } from "./store.js";
import { typed } from "./stop.js";

function toggle() {
  const hidden = ($("keys").hidden = !$("keys").hidden);
  $("keys-button").setAttribute("aria-expanded", String(!hidden));
}

export function connectKeys() {
  $("keys-button").addEventListener("click", toggle);
  window.addEventListener("keydown", (event) => {
    if (typed(event.target) || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "?") toggle();
    else if (event.key === "+") zoom(.5);
    else if (event.key === "-") zoom(2);
    else if (event.key === "0") unzoom();
    else return;
    event.preventDefault();
  });
}
