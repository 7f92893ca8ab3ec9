// Sends the keys that are held, and the controllers of a headset, to the program. The packets are described in
// docs/teleoperation.md. KNOWN_KEYS and HAS_HEADSET are defined by the program.
(() => {
  "use strict";
  const HEARTBEAT_MS = 200; // packets are also sent while nothing changes, so that the program notices a frozen page
  const RECONNECT_MS = 500;
  const MAX_BUFFERED = 65536; // bytes; if more wait to be sent, the connection hangs, and newer packets matter more
  const held = new Set();
  let socket = null;
  let session = null;
  let banner = null;

  const send = (content) => {
    if (socket !== null && socket.readyState === WebSocket.OPEN && socket.bufferedAmount < MAX_BUFFERED)
      socket.send(JSON.stringify(content));
  };
  const sendKeys = () => send({ keys: [...held] });
  const release = () => {
    held.clear();
    sendKeys();
  };

  const connect = () => {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    socket = new WebSocket(`${scheme}//${location.host}/teleop-socket`);
    socket.onopen = sendKeys;
    socket.onmessage = (event) => showBanner(!JSON.parse(event.data).drives);
    socket.onclose = () => setTimeout(connect, RECONNECT_MS);
  };

  // Only one window drives at a time.
  const showBanner = (isShown) => {
    if (banner !== null) banner.remove();
    banner = null;
    if (!isShown || document.body === null) return;
    banner = document.createElement("button");
    banner.textContent = "Another window drives the robot. Click here to drive it from this one.";
    banner.style.cssText = "position:fixed;left:1em;bottom:1em;z-index:1000;padding:0.8em;background:#fd7;border:0";
    banner.onclick = () => {
      send({ take: true });
      banner.blur();
    };
    document.body.appendChild(banner);
  };

  const isTyping = (target) =>
    target instanceof HTMLElement &&
    (target.isContentEditable || target.tagName === "TEXTAREA" ||
      (target.tagName === "INPUT" && !["button", "checkbox", "radio"].includes(target.type)));

  const onKey = (event, isDown) => {
    if (!KNOWN_KEYS.includes(event.code) || isTyping(event.target)) return;
    if (isDown && (event.ctrlKey || event.metaKey || event.altKey)) return;
    event.preventDefault(); // a focused button would be pressed by Space, and Tab would move the focus
    event.stopImmediatePropagation(); // the view moves its camera with the same keys
    if (isDown === held.has(event.code)) return;
    if (isDown) held.add(event.code);
    else held.delete(event.code);
    sendKeys();
  };
  window.addEventListener("keydown", (event) => onKey(event, true), true);
  window.addEventListener("keyup", (event) => onKey(event, false), true);
  window.addEventListener("blur", release);
  document.addEventListener("visibilitychange", () => document.hidden && release());
  setInterval(sendKeys, HEARTBEAT_MS);

  // -- headsets ----------------------------------------------------------------------------------------------------

  const controllerPacket = (input, frame, space) => {
    const pose = input.gripSpace ? frame.getPose(input.gripSpace, space) : null;
    const pad = input.gamepad;
    if (!pose || !pad || !["left", "right"].includes(input.handedness)) return;
    const { position: p, orientation: q } = pose.transform;
    const value = (k) => (pad.buttons[k] ? pad.buttons[k].value : 0);
    send({
      hand: input.handedness,
      position: [p.x, p.y, p.z],
      orientation: [q.x, q.y, q.z, q.w],
      squeeze: value(1),
      trigger: value(0),
      buttons: pad.buttons.flatMap((button, k) => (button.pressed && k < 32 ? [k] : [])),
    });
  };

  const enterHeadset = async () => {
    const mode = (await navigator.xr.isSessionSupported("immersive-ar")) ? "immersive-ar" : "immersive-vr";
    session = await navigator.xr.requestSession(mode, { requiredFeatures: ["local-floor"] });
    const gl = document.createElement("canvas").getContext("webgl", { xrCompatible: true });
    session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
    const space = await session.requestReferenceSpace("local-floor");
    const onFrame = (_time, frame) => {
      for (const input of session.inputSources) controllerPacket(input, frame, space);
      session.requestAnimationFrame(onFrame);
    };
    session.addEventListener("end", () => (session = null));
    session.requestAnimationFrame(onFrame);
  };

  const offerHeadset = () => {
    const button = document.createElement("button");
    const isPossible = window.isSecureContext && navigator.xr !== undefined;
    button.id = "teleop-headset";
    button.textContent = isPossible
      ? "Use a headset"
      : "This browser has no WebXR here; open the page in the headset's browser as https or as localhost.";
    button.disabled = !isPossible;
    button.style.cssText = "position:fixed;left:1em;top:1em;z-index:1000;padding:0.8em";
    button.onclick = () => enterHeadset().catch((error) => (button.textContent = `No headset: ${error.message}`));
    document.body.appendChild(button);
  };

  connect();
  if (HAS_HEADSET) window.addEventListener("DOMContentLoaded", offerHeadset);
})();
