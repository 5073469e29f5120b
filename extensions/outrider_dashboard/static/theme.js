// Light or dark: as the system has it, until the user chooses.

const KEY = "outrider-colours";
const CHOICES = ["auto", "dark", "light"];
const SIGNS = { auto: "◐", dark: "☾", light: "☀" };
const SAID = { auto: "as the system's", dark: "dark", light: "light" };

export const isDark = () => document.body.classList.contains("body--dark");

// Watch the choice; `onChange` is called whenever the page has turned light or dark.
export function watchTheme(button, onChange) {
  let choice = stored();
  const apply = () => {
    Quasar.Dark.set(choice === "auto" ? "auto" : choice === "dark"); // global, as NiceGUI loads it
    button.textContent = SIGNS[choice];
    button.title = `Colours: ${SAID[choice]}. Press for the next choice.`;
    button.setAttribute("aria-label", `colours: ${SAID[choice]}`);
  };
  button.addEventListener("click", () => {
    choice = CHOICES[(CHOICES.indexOf(choice) + 1) % CHOICES.length];
    try {
      localStorage.setItem(KEY, choice);
    } catch {
      // a browser without storage forgets the choice
    }
    apply();
  });
  let dark = null;
  const look = () => {
    if (dark === isDark()) return;
    dark = isDark();
    onChange();
  };
  new MutationObserver(look).observe(document.body, { attributes: true, attributeFilter: ["class"] });
  apply();
  look();
}

function stored() {
  try {
    const found = localStorage.getItem(KEY);
    return CHOICES.includes(found) ? found : "auto";
  } catch {
    return "auto";
  }
}
