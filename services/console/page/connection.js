// The one WebSocket: binary frames in, JSON requests out; comes back by itself.

const FIRST_DELAY = 500; // ms
const LONGEST_DELAY = 3000;

/** Parse a frame: uint32 LE n, n bytes of JSON, payload. Returns [header, payload: Uint8Array]. */
export function parseFrame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return [header, new Uint8Array(buffer, 4 + length)];
}

const TOKEN = 'token';
let known = null;

/** Take the token out of the address, where neither history nor a screenshot keeps it. Returns whether there was one. */
export function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get(TOKEN);
  if (!given) return false;
  known = given;
  try {
    sessionStorage.setItem(TOKEN, given); // for a reload of this tab
  } catch { /* a browser that stores nothing asks for the address again */ }
  history.replaceState(history.state, '', location.pathname + location.search);
  return true;
}

/** The token that `vantage up` printed with the address, or null. */
export function token() {
  try {
    known ??= sessionStorage.getItem(TOKEN);
  } catch { /* as above */ }
  return known;
}

export class Connection {
  /**
   * @param {(header: Object, payload: Uint8Array) => void} onFrame
   * @param {(connected: boolean, why: string) => void} onChange why: what the server said when it closed, or empty.
   */
  constructor(onFrame, onChange) {
    this.onFrame = onFrame;
    this.onChange = onChange;
    this.delay = FIRST_DELAY;
    this.opened = false; // ever
    this.socket = null;
    this.timer = 0;
  }

  open() {
    clearTimeout(this.timer);
    const url = new URL('bus', location.href);
    url.protocol = location.protocol === 'https:' ? 'wss:' : 'ws:';
    url.hash = '';
    const secret = token();
    const socket = new WebSocket(url, secret ? ['vantage', secret] : ['vantage']);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    let greeted = false; // a server that is full accepts, says why and closes: that is no connection
    socket.onmessage = (event) => {
      if (this.socket !== socket) return;
      if (!greeted) {
        greeted = this.opened = true;
        this.delay = FIRST_DELAY;
        this.onChange(true, '');
      }
      this.onFrame(...parseFrame(event.data));
    };
    socket.onclose = (event) => {
      if (this.socket !== socket) return; // replaced on purpose
      this.onChange(false, event.reason);
      this.timer = setTimeout(() => this.open(), this.delay);
      this.delay = Math.min(this.delay * 1.6, LONGEST_DELAY);
    };
  }

  /** Close and come back at once: the server then says everything again. */
  renew() {
    const old = this.socket;
    this.socket = null;
    if (old) old.close();
    this.open();
  }

  /** Send a request; returns whether it went out. */
  send(request) {
    if (!this.socket || this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(request));
    return true;
  }
}
