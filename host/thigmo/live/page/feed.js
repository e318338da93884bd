// The stream from the server: batches of messages over one WebSocket. Each batch is acknowledged, so
// that the server knows how far behind this page is and drops readings instead of queueing them.

// What the server has at an address: data from JSON, { problem } where it refuses, null where it has
// gone, which the stream notices.
export async function read(address) {
  try {
    const answer = await fetch(address);
    return answer.ok ? await answer.json() : { problem: await answer.text() };
  } catch {
    return null;
  }
}

const RETRY_MS = 700;
const SILENT_MS = 1500; // the server speaks four times a second

export function listen({ opened, batch, lost }) {
  let socket = null, heard = performance.now(), down = false;
  const url = new URL("stream", location.href);
  url.protocol = url.protocol.replace("http", "ws");

  function open() {
    const mine = (socket = new WebSocket(url));
    mine.onopen = () => {
      heard = performance.now(); // it has as long to speak as any other
      opened();
    };
    mine.onmessage = (event) => {
      heard = performance.now();
      down = false;
      batch(JSON.parse(event.data));
      if (mine.readyState === WebSocket.OPEN) mine.send('{"ack":1}');
    };
    mine.onclose = () => {
      if (socket !== mine) return;
      fail();
      setTimeout(open, RETRY_MS);
    };
  }

  function fail() {
    if (!down) lost();
    down = true;
  }

  setInterval(() => {
    if (performance.now() - heard < SILENT_MS) return;
    fail();
    // A socket that is open and silent may belong to a server that has gone without a word.
    if (socket.readyState === WebSocket.OPEN && performance.now() - heard > 4 * SILENT_MS) socket.close();
  }, 250);
  open();
  return { send: (message) => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message)) };
}
