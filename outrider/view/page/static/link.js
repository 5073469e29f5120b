// The channel to the dashboard's process: frames in, words out. Opens again whenever it was closed.

export function openLink({ onHello, onFrame, onLost }) {
  let socket = null;
  let wait = 250;

  function say(word) {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(word));
  }

  function open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/frames`);
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.kind === "hello") {
        wait = 250;
        onHello(message);
      } else {
        onFrame(message);
      }
    };
    socket.onclose = () => {
      onLost();
      setTimeout(open, wait);
      wait = Math.min(wait * 1.6, 3000);
    };
  }

  open();
  setInterval(() => say({ kind: "here" }), 1000);
  return { say };
}
