// The channel to the dashboard's process: frames in, words out. Opens again whenever it was closed.

const QUIET = 3000; // so long an open channel may bring no frame [ms]
const PATIENCE = 4000; // so long an answer over HTTP may take [ms]
const PROBE = "/static/favicon.svg";

// `onSilence` is called with what is known of the fault, whenever no frame comes: `websocket` (the dashboard answers
// over HTTP alone), `refused` (it answers, and does not admit this page), `silent` (it does not answer), `still` (the
// channel is open, and brings nothing).
export function openLink({ onHello, onFrame, onSilence }) {
  let socket = null;
  let wait = 250;
  let heard = performance.now();

  function say(word) {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(word));
  }

  function open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/frames`);
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      heard = performance.now();
      if (message.kind === "hello") {
        wait = 250;
        onHello(message);
      } else {
        onFrame(message);
      }
    };
    socket.onclose = async () => {
      const closed = socket;
      onSilence(await probe());
      if (socket === closed) setTimeout(open, wait);
      wait = Math.min(wait * 1.6, 3000);
    };
  }

  document.addEventListener("visibilitychange", () => (heard = performance.now())); // a hidden page gets no frames
  setInterval(() => {
    const open = socket && socket.readyState === WebSocket.OPEN;
    if (open && !document.hidden && performance.now() - heard > QUIET) onSilence("still");
  }, 500);

  open();
  setInterval(() => say({ kind: "here" }), 1000);
  return { say };
}

async function probe() {
  try {
    const answer = await fetch(PROBE, { method: "HEAD", cache: "no-store", signal: AbortSignal.timeout(PATIENCE) });
    return answer.ok ? "websocket" : answer.status === 401 ? "refused" : "silent";
  } catch {
    return "silent";
  }
}

// What a user is told of a fault.
export function explain(fault) {
  const channel = `ws${location.protocol === "https:" ? "s" : ""}://${location.host}/frames`;
  return {
    websocket: `No frames come: the dashboard answers over HTTP, but the WebSocket ${channel} does not stay open. If a proxy is in between, it must pass WebSocket upgrades. Trying again.`,
    refused: "The dashboard no longer admits this page. Reload it, and enter the token.",
    silent: "The dashboard's own process does not answer. Waiting for it.",
    still: `No frames come, although the WebSocket ${channel} is open. Waiting for them.`,
  }[fault];
}
