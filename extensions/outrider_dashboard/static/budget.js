// Entry point of the page of the network budget.

import { watchTheme } from "./theme.js";

// Wait for the page: NiceGUI builds it after this file has loaded.
function whenBuilt(then) {
  const button = document.getElementById("theme");
  if (button) then(button);
  else setTimeout(() => whenBuilt(then), 30);
}

whenBuilt((button) => watchTheme(button, () => {}));
