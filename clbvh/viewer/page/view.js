// The page of the viewer: forwards events to Python, and shows the pictures that come back. Python navigates, picks,
// measures and renders; docs/internals/viewer.md lists the messages. One file, as anywidget wants it, and no other.
//
//   mount(element, channel)    the viewer inside an element; a channel is {send(event), listen(callback)}
//   connect(element, address)  the same over a websocket
//   default.render             the same in a notebook, by anywidget

const SIGN_AFTER_MS = 300;
const NOTE_MS = 6000;
const NARROW_PX = 600; // as in view.css
const TAP_PX = 4; // a finger that moves less taps
const LINE_PX = 16; // of wheels that count in lines
const PINCH_PX = 667; // wheel pixels that bring e times as near: Python takes 1.0015 for one
const TOUCHPAD_PINCH = 6.67; // times the wheel events with which browsers tell pinches: those take 100 px
const BUTTONS = [1, 3, 2, 4, 5]; // of PointerEvent.button; in our events 1 is the left one, 2 the right one
const EXACT = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
const TINT = [255, 150, 30]; // of the selection
const HELP = [
  ["Drag", "orbit; in flight, look around"], ["Right or Shift drag, two fingers", "pan"], ["Wheel, pinch", "zoom"],
  ["Click", "face, part, location"], ["Two clicks", "distance"], ["Double click", "go there"],
  ["Arrows", "move; with Shift faster"], ["G, then W A S D Q E", "fly"], ["F R B L T U I", "sides, iso"],
  ["1 to 8", "shading"], ["M", "wireframe"], ["Space", "turntable"], ["H", "home"], ["Esc", "clear the marks"],
];

function make(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

const makeButton = (textContent, onclick) => make("button", { type: "button", textContent, onclick });
const listModifiers = (event) => ["Shift", "Control", "Alt", "Meta"].filter((key) => event.getModifierState?.(key));

// Show the viewer in an element. Returns a function that removes it.
export function mount(element, channel) {
  let isEnded = false;
  const send = (event_type, fields) => isEnded || channel.send({ event_type, ...fields });
  const notes = make("div", { className: "notes", role: "status" });
  const lost = make("div", { className: "lost", role: "alert", hidden: true });
  const showLost = (text, ...buttons) => (lost.replaceChildren(text, ...buttons), (lost.hidden = !text));
  const reconnect = makeButton("Reconnect", () => (showLost("Connecting ..."), channel.reconnect()));

  function note({ text, is_error }) {
    const shown = makeButton(text, () => shown.remove());
    Object.assign(shown, { title: "Click to close", className: is_error ? "error" : "" });
    for (const older of [...notes.children]) if (older.textContent === text) older.remove();
    notes.append(shown);
    if (!is_error) setTimeout(() => shown.remove(), NOTE_MS);
  }

  const picture = makePicture(send, note);
  const panel = makePanel(send, picture.stage);
  const root = make("div", { className: "clbvh-view" }, picture.stage, panel.node, lost, notes);
  root.dataset.lmSuppressShortcuts = "true"; // keys here are no commands of JupyterLab's
  element.append(root);
  panel.fold(root.clientWidth < NARROW_PX);
  listenPointers(picture, send);
  listenKeys(picture.stage, send);

  const listeners = {
    scene: (message) => (panel.showScene(message), picture.showScene(message)),
    state: (message) => (panel.showState(message), picture.expect()),
    frame: (message, bytes) => (panel.showFrame(message), picture.showFrame(message, bytes)),
    overlay: picture.showOverlay,
    hit: panel.showHit,
    text: async (message) => note({ text: await panel.showText(message) }),
    file: saveFile,
    note: (message) => (message.is_error && picture.stopSigns(), note(message)),
    closed: ({ text }) => (picture.stopSigns(), showLost(text, ...(channel.reconnect ? [reconnect] : []))),
    opened: () => (showLost(""), picture.restart()), // by `connect`, or where another view was closed
  };
  const stopListening = channel.listen((message, bytes) => listeners[message.type]?.(message, bytes));
  const sizes = new ResizeObserver(picture.place);
  sizes.observe(picture.stage);
  addEventListener("resize", picture.place); // another pixel ratio
  return () => {
    send("close");
    isEnded = true;
    sizes.disconnect();
    removeEventListener("resize", picture.place);
    stopListening?.();
    root.remove();
  };
}

// The picture; the overlay with the selection and the marks; the signs of progress.
function makePicture(send, note) {
  const canvas = make("canvas", { className: "picture" });
  const overlay = make("canvas", { className: "overlay" });
  const progress = make("div", { className: "progress", hidden: true });
  const sign = make("div", { className: "sign", textContent: "rendering", hidden: true });
  const stage = make("div", { className: "stage", tabIndex: 0, role: "application" }, canvas, overlay, progress, sign);
  let size = { width: 0, height: 0, pixel_ratio: 0 }; // of the picture, in CSS pixels
  let fixed = null; // {width, height} in pixels, of a picture that keeps its size
  let [newest, overlays] = [0, 0]; // index of the frame that is shown, and how many overlays have come
  let above = { marks: [] }; // what is drawn over the frame
  let timer = 0;

  const decode = (bytes, format) => createImageBitmap(new Blob([bytes], { type: `image/${format}` }), EXACT);
  const expect = () => (clearTimeout(timer), (timer = setTimeout(() => (sign.hidden = false), SIGN_AFTER_MS)));
  const stopSigns = () => (clearTimeout(timer), (sign.hidden = progress.hidden = true));

  // Lay the picture on whole pixels of the screen, and tell Python its size where it changed.
  function place() {
    const outer = [stage.clientWidth, stage.clientHeight];
    if (!outer[0] || !outer[1]) return; // not shown
    const snap = (length) => Math.round(length * devicePixelRatio) / devicePixelRatio;
    const scale = fixed && Math.min(outer[0] / fixed.width, outer[1] / fixed.height);
    const [width, height] = fixed ? [snap(fixed.width * scale), snap(fixed.height * scale)] : outer.map(snap);
    const lengths = { left: snap((outer[0] - width) / 2), top: snap((outer[1] - height) / 2), width, height };
    for (const { style } of [canvas, overlay]) for (const name in lengths) style[name] = `${lengths[name]}px`;
    const before = size;
    size = { width, height, pixel_ratio: devicePixelRatio };
    if (Object.keys(size).every((name) => size[name] === before[name])) return;
    send("resize", size);
    drawOverlay();
  }

  // A newer frame may be there already. Python waits for the feedback in any case.
  async function showFrame(message, bytes) {
    const shown = decode(bytes, message.format).then((bitmap) => message.index > newest && draw(message, bitmap));
    await shown.catch((error) => note({ text: `A picture cannot be shown: ${error.message}`, is_error: true }));
    const answer = () => send("frame_feedback", { index: message.index });
    document.hidden ? requestAnimationFrame(answer) : answer(); // no work for a tab that nobody sees
  }

  function draw({ index, settled, samples, of_samples }, bitmap) {
    const { width, height } = bitmap;
    newest = index;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d");
    context.globalCompositeOperation = "copy";
    context.drawImage(bitmap, 0, 0);
    bitmap.close();
    Object.assign(canvas.dataset, { index, settled });
    stopSigns();
    if (settled) return;
    expect();
    progress.hidden = of_samples < 2;
    progress.style.width = `${(100 * samples) / of_samples}%`;
  }

  async function showOverlay(message, bytes) {
    const own = ++overlays;
    const mask = bytes && tint(await decode(bytes, "png"));
    if (own !== overlays) return;
    above = { ...message, mask };
    drawOverlay();
  }

  function drawOverlay() {
    const [{ width, height }, scale] = [size, devicePixelRatio];
    Object.assign(overlay, { width: Math.round(width * scale), height: Math.round(height * scale) });
    const context = overlay.getContext("2d");
    context.scale(scale, scale);
    if (above.mask) context.drawImage(above.mask, 0, 0, width, height);
    const marks = above.marks.filter(Boolean); // null behind the camera
    const rings = marks.map(({ x, y }) => `M${x - 5} ${y}a5 5 0 1 0 10 0a5 5 0 1 0 -10 0`).join("");
    const [first, second] = above.measure ? marks : [];
    const path = new Path2D(second ? `${rings}M${first.x} ${first.y}L${second.x} ${second.y}` : rings);
    const label = second && [above.measure, (first.x + second.x) / 2, (first.y + second.y) / 2 - 8];
    Object.assign(context, { font: "600 13px system-ui, sans-serif", textAlign: "center", lineJoin: "round" });
    for (const [colour, lineWidth] of [["#000b", 5], ["#fff", 2]]) {
      Object.assign(context, { strokeStyle: colour, fillStyle: colour, lineWidth });
      context.stroke(path);
      if (label) lineWidth > 2 ? context.strokeText(...label) : context.fillText(...label);
    }
  }

  function showScene(scene) {
    stage.ariaLabel = `Picture of ${scene.title}: drag, or use keys, to look around`;
    fixed = scene.width && scene.height ? { width: scene.width, height: scene.height } : null;
    place();
  }

  function restart() {
    newest = 0;
    if (size.width) send("resize", size);
    expect();
  }

  return { stage, canvas, expect, stopSigns, place, showFrame, showOverlay, showScene, restart };
}

// Turn a mask in shades of grey into a half transparent picture of one colour.
function tint(bitmap) {
  const tinted = make("canvas", { width: bitmap.width, height: bitmap.height });
  const context = tinted.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  const pixels = context.getImageData(0, 0, tinted.width, tinted.height);
  for (let i = 0; i < pixels.data.length; i += 4) pixels.data.set([...TINT, pixels.data[i] / 2], i);
  context.putImageData(pixels, 0, 0);
  return tinted;
}

function saveFile({ name }, bytes) {
  const href = URL.createObjectURL(new Blob([bytes], { type: "image/png" }));
  make("a", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), NOTE_MS);
}

// Mouse, pen and fingers. Moves and wheels wait for the next animation frame: it has at most one of each.
function listenPointers({ stage, canvas }, send) {
  const places = new Map(); // of the mouse or of fingers that are down
  const waiting = new Map(); // events of this animation frame, by their type
  let drag = null; // {button, at, isTold, isTap}
  let spread = 0; // distance of two fingers

  const on = (type, listener) => stage.addEventListener(type, listener, { passive: false });
  const flush = () => (waiting.forEach((fields, type) => send(type, fields)), waiting.clear());
  const sendNow = (type, fields) => (flush(), send(type, fields));
  const middle = ([[x0, y0], [x1, y1]]) => [(x0 + x1) / 2, (y0 + y1) / 2];
  const distance = ([[x0, y0], [x1, y1]]) => Math.hypot(x1 - x0, y1 - y0);

  function sendLater(type, fields) {
    if (!waiting.size) requestAnimationFrame(flush);
    waiting.set(type, fields);
  }

  function locate(event) {
    const { left, top } = canvas.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }

  function describe(event, [x, y], fields = { button: drag.button, buttons: [drag.button] }) {
    const ntouches = event.pointerType === "touch" ? places.size : 0;
    return { x, y, modifiers: listModifiers(event), ntouches, touches: {}, ...fields };
  }

  // A finger is told when it moves, or when it was lifted at once: so the first finger of a pinch is no click.
  function tell(event) {
    if (!drag.isTold) sendNow("pointer_down", describe(event, drag.at));
    drag.isTold = true;
  }

  function release(event) {
    if (drag?.isTap && event.type === "pointerup") tell(event);
    if (drag?.isTold) sendNow("pointer_up", describe(event, drag.at, { button: drag.button, buttons: [] }));
    drag = null;
  }

  function scroll(event, at, dx, dy) {
    const before = waiting.get("wheel") ?? { dx: 0, dy: 0 };
    sendLater("wheel", describe(event, at, { dx: before.dx + dx, dy: before.dy + dy }));
  }

  // One finger is the left button, and two are the right one.
  function grip(button, isTap) {
    const at = [...places.values()];
    drag = null;
    if (at.length === 1) drag = { button, at: at[0], isTap };
    if (at.length === 2) drag = { button: 2, at: middle(at) };
    spread = at.length === 2 ? distance(at) : 0;
  }

  on("pointerdown", (event) => {
    event.preventDefault();
    stage.focus({ preventScroll: true });
    stage.setPointerCapture(event.pointerId);
    release(event);
    places.set(event.pointerId, locate(event));
    grip(BUTTONS[event.button] ?? 0, true);
    if (event.pointerType !== "touch") tell(event);
  });

  on("pointermove", (event) => {
    if (!drag || !places.has(event.pointerId)) return;
    places.set(event.pointerId, locate(event));
    const at = spread ? middle([...places.values()]) : locate(event);
    if (spread) {
      const now = distance([...places.values()]) || 1;
      scroll(event, at, 0, PINCH_PX * Math.log(spread / now));
      spread = now;
    }
    if (!drag.isTold && distance([drag.at, at]) < TAP_PX) return;
    tell(event);
    drag.at = at;
    const buttons = [1, 2, 3, 4, 5].filter((button) => event.buttons & (1 << (button - 1)));
    sendLater("pointer_move", describe(event, at, { button: 0, buttons: spread ? [2] : buttons }));
  });

  for (const type of ["pointerup", "pointercancel"]) {
    on(type, (event) => (release(event), places.delete(event.pointerId) && grip(1, false)));
  }

  on("wheel", (event) => {
    event.preventDefault();
    event.stopPropagation(); // nor does a notebook scroll
    const scale = event.ctrlKey ? TOUCHPAD_PINCH : [1, LINE_PX, stage.clientHeight][event.deltaMode];
    scroll(event, locate(event), event.deltaX * scale, event.deltaY * scale);
  });

  on("dblclick", (event) => sendNow("double_click", describe(event, locate(event), { button: 1, buttons: [] })));
  // Neither does the middle button scroll, nor the right one open a menu.
  for (const type of ["mousedown", "contextmenu"]) on(type, (event) => event.preventDefault());
}

// Keys on the picture. A key goes up by the name with which it went down, also where Shift changed in between.
function listenKeys(stage, send) {
  const held = new Map();

  function release(event, codes) {
    const keys = codes.flatMap((code) => held.get(code) ?? []);
    for (const key of keys) send("key_up", { key, modifiers: listModifiers(event) });
    for (const code of codes) held.delete(code);
  }

  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(Tab|F\d+)$/.test(event.key)) return; // the browser's
    event.preventDefault(); // no scrolling
    event.stopPropagation();
    if (event.repeat) return;
    held.set(event.code, event.key);
    send("key_down", { key: event.key, modifiers: listModifiers(event) });
  });
  // While Meta is held, macOS tells of no key that goes up.
  stage.addEventListener("keyup", (event) => release(event, event.key === "Meta" ? [...held.keys()] : [event.code]));
  stage.addEventListener("blur", (event) => release(event, [...held.keys()]));
}

// The panel at the side: what is shown, and how; what was clicked; what to take away.
function makePanel(send, stage) {
  const set = (name, value) => send("set", { name, value });
  const asking = (text, what) => makeButton(text, () => send("ask", { what }));
  const makeCheck = (onchange) => make("input", { type: "checkbox", onchange });
  const makeLabel = (box, text) => make("label", { className: "check" }, box, text);
  const makeRow = (...children) => make("div", { className: "row" }, ...children);
  const makeSection = (title, ...children) => make("section", {}, make("h3", { textContent: title }), ...children);
  const fillTable = (table, pairs) => (table.replaceChildren(...pairs.map(([textContent, value]) =>
    make("tr", {}, make("th", { textContent, scope: "row" }), make("td", { textContent: value })))), table);

  const title = make("h2", { textContent: "clbvh" });
  const facts = make("p");
  const folding = makeButton("", () => fold(!node.classList.contains("folded")));
  const shading = make("select", { ariaLabel: "Shading", onchange: () => set("shading", shading.value) });
  const wireframe = makeCheck(() => set("wireframe", wireframe.checked));
  const sides = makeRow();
  const turntable = asking("turntable", "turntable");
  const fly = makeCheck(() => set("fly", fly.checked));
  const axis = make("select", { ariaLabel: "Axis of the cut", onchange: setCut });
  axis.append(...["no cut", "x", "y", "z"].map((name) => new Option(name)));
  const flip = makeCheck(setCut);
  const height = make("input", { type: "range", value: 50, ariaLabel: "Place of the cut", oninput: setCut });
  const share = make("output", { textContent: "50%" });
  const hit = make("table");
  const hitSection = makeSection("Clicked", hit, asking("clear", "clear"));
  Object.assign(hitSection, { className: "clicked", hidden: true });
  const text = make("textarea", { readOnly: true, hidden: true, spellcheck: false, onfocus: () => text.select() });
  const figures = make("p", { className: "figures" });
  const files = makeRow(asking("save PNG", "png"), asking("copy command", "command"), asking("copy Python", "python"));

  const body = make("div", { className: "body" }, facts,
    makeSection("Shading", shading, makeRow(makeLabel(wireframe, "wireframe"))),
    makeSection("View", sides, makeRow(asking("home", "home"), turntable, makeLabel(fly, "fly"))),
    makeSection("Cut", makeRow(axis, makeLabel(flip, "flip")), makeRow(height, share)),
    makeSection("Take away", files, text),
    make("details", {}, make("summary", { textContent: "Mouse and keys" }), fillTable(make("table"), HELP)), figures);
  const node = make("aside", { className: "panel", ariaLabel: "Settings" }, make("header", {}, title, folding), hitSection, body);
  // After a click of the mouse, keys belong to the picture again.
  node.onclick = (event) => event.detail && event.target.closest("button, .check, summary") && stage.focus();

  function fold(isFolded) {
    node.classList.toggle("folded", isFolded);
    folding.ariaExpanded = String(!isFolded);
    folding.title = folding.ariaLabel = isFolded ? "Show the panel" : "Hide the panel";
  }

  function setCut() {
    share.textContent = `${height.value}%`;
    set("cut", axis.selectedIndex ? `${axis.value}${flip.checked ? "<" : "="}${height.value}%` : null);
  }

  function showScene(scene) {
    title.textContent = title.title = scene.title;
    facts.textContent = scene.facts;
    shading.replaceChildren(...scene.shadings.map((name) => new Option(name)));
    sides.replaceChildren(...scene.sides.map((name) => makeButton(name, () => set("side", name))));
  }

  function showState(state) {
    shading.value = state.shading;
    wireframe.checked = state.wireframe;
    fly.checked = state.fly;
    turntable.ariaPressed = String(state.turntable);
    const [, along, sign, place] = /^([xyz])([=<>])([\d.]+)%$/.exec(state.cut) ?? [];
    axis.value = along ?? "no cut";
    if (along) flip.checked = sign === "<";
    if (along && !height.matches(":focus")) height.value = place; // a slider that moves is ahead of Python
    share.textContent = state.cut && !along ? state.cut : `${height.value}%`;
  }

  const showFrame = ({ width, height, samples, of_samples, frame_ms }) => (figures.textContent =
    `${width} × ${height}, ${samples} of ${of_samples} samples, ${Math.round(frame_ms)} ms`);
  const showHit = ({ lines }) => (fillTable(hit, lines), (hitSection.hidden = !lines.length));

  // Returns whether the text is on the clipboard, which a browser may refuse, as a sentence.
  async function showText(message) {
    const name = message.what === "python" ? "Python" : "Command";
    Object.assign(text, { value: message.text, hidden: false, rows: 6, ariaLabel: name });
    const isCopied = await navigator.clipboard?.writeText(message.text).then(() => true, () => false);
    return isCopied ? `${name} copied` : `${name}: the browser keeps its clipboard, copy the text from the panel`;
  }

  return { node, fold, showScene, showState, showFrame, showHit, showText };
}

// Show the viewer in an element over a websocket. The page's own address has the token.
export function connect(element, address = new URL(`/socket${location.search}`, location.href.replace(/^http/, "ws"))) {
  let socket, tell;

  function open() {
    let header = null; // of the binary message that comes next
    socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => tell({ type: "opened" }, null);
    socket.onclose = ({ reason }) => tell({ type: "closed", text: reason || "The connection is lost." }, null);
    socket.onmessage = ({ data }) => {
      const isText = typeof data === "string";
      const message = isText ? JSON.parse(data) : header;
      header = isText && message.bytes > 0 ? message : null;
      if (!header) tell(message, isText ? null : data);
    };
  }

  const unmount = mount(element, {
    send: (event) => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify(event)),
    listen: (callback) => ((tell = callback), open()),
    reconnect: open,
  });
  return () => (unmount(), socket.close());
}

function render({ model, el }) {
  const unmount = mount(el, {
    send: (event) => model.send(event),
    listen(callback) {
      const listener = (message, buffers) => callback(message, buffers?.[0] ?? null);
      model.on("msg:custom", listener);
      return () => model.off("msg:custom", listener);
    },
  });
  el.lastElementChild.style.height = model.get("css_height");
  return unmount;
}
export default { render };

const page = document.querySelector("[data-clbvh-view]");
if (page) {
  connect(page);
  page.querySelector(".stage").focus({ focusVisible: false });
}
