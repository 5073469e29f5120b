// WebSocket to the dashboard process; reconnects when it is closed.

const QUIET = 3000; // longest time without a frame on an open WebSocket [ms]
const PATIENCE = 4000; // timeout of an HTTP request [ms]
// Relative to this file: a proxy may serve the page under a path of its own.
const PROBE = new URL("favicon.svg", import.meta.url);
const CHANNEL = new URL("../frames", import.meta.url);
CHANNEL.protocol = CHANNEL.protocol.replace("http", "ws");

// Connect; `onSilence` is called with the fault when no frames arrive: `websocket` (the dashboard answers over HTTP
// only), `rejected` (it does not admit this page), `silent` (it does not answer), `still` (the WebSocket is open, but
// carries no frames).
export function openLink({ onHello, onFrame, onSilence }) {
  let socket = null;
  let wait = 250;
  let heard = performance.now();

  function send(message) {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  }

  function open() {
    socket = new WebSocket(CHANNEL);
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

  document.addEventListener("visibilitychange", () => (heard = performance.now())); // a hidden page receives no frames
  setInterval(() => {
    const open = socket && socket.readyState === WebSocket.OPEN;
    if (open && !document.hidden && performance.now() - heard > QUIET) onSilence("still");
  }, 500);

  open();
  setInterval(() => send({ kind: "here" }), 1000);
  return { send };
}

async function probe() {
  try {
    const answer = await fetch(PROBE, { method: "HEAD", cache: "no-store", signal: AbortSignal.timeout(PATIENCE) });
    return answer.ok ? "websocket" : answer.status === 401 ? "rejected" : "silent";
  } catch {
    return "silent";
  }
}

// Return the message for a fault.
export function explain(fault) {
  return {
    websocket: `No data: the dashboard answers over HTTP, but the WebSocket ${CHANNEL} does not stay open. A proxy must forward WebSocket upgrades. Reconnecting.`,
    rejected: "The dashboard no longer accepts this page. Reload it with the current token.",
    silent: "The dashboard process does not answer. Reconnecting.",
    still: `No data, although the WebSocket ${CHANNEL} is open. Waiting for the dashboard.`,
  }[fault];
}
