// Light or dark theme: the system's, unless the user chooses one.

const KEY = "outrider-colours";
const CHOICES = ["auto", "dark", "light"];
const SIGNS = { auto: "◐", dark: "☾", light: "☀" };
const LABELS = { auto: "system", dark: "dark", light: "light" };

export const isDark = () => document.body.classList.contains("body--dark");

// Apply the chosen theme; call `onChange` whenever the page turns light or dark.
export function watchTheme(button, onChange) {
  let choice = stored();
  const apply = () => {
    Quasar.Dark.set(choice === "auto" ? "auto" : choice === "dark"); // global, as NiceGUI loads it
    button.textContent = SIGNS[choice];
    button.title = `Theme: ${LABELS[choice]}. Click to change.`;
    button.setAttribute("aria-label", `Theme: ${LABELS[choice]}`);
  };
  button.addEventListener("click", () => {
    choice = CHOICES[(CHOICES.indexOf(choice) + 1) % CHOICES.length];
    try {
      localStorage.setItem(KEY, choice);
    } catch {
      // without local storage the choice is not saved
    }
    apply();
  });
  let dark = null;
  const check = () => {
    if (dark === isDark()) return;
    dark = isDark();
    onChange();
  };
  new MutationObserver(check).observe(document.body, { attributes: true, attributeFilter: ["class"] });
  apply();
  check();
}

function stored() {
  try {
    const found = localStorage.getItem(KEY);
    return CHOICES.includes(found) ? found : "auto";
  } catch {
    return "auto";
  }
}
