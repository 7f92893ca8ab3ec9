/** Runs in the page of the preview: shows what the extension sends, and sends it gestures. */

import type { PageMessage, Shown } from "./protocol";

declare function acquireVsCodeApi(): { postMessage(message: PageMessage): void };

const api = acquireVsCodeApi();
const picture = document.getElementById("picture") as HTMLImageElement;
const message = document.getElementById("message")!;

/** A drag across 200 pixels turns the scene by a quarter [degrees per pixel]. */
const TURN = 90 / 200;
/** Ten notches of a wheel, of 100 pixels each, come nearer by a factor of e [per pixel]. */
const APPROACH = 0.001;
/** One press of an arrow key turns the scene by this angle [degrees]. */
const STEP_DEG = 5;

function show(shown: Partial<Shown>): void {
  if (typeof shown.png === "string" && /^[A-Za-z0-9+/=]+$/.test(shown.png)) picture.src = `data:image/png;base64,${shown.png}`;
  message.textContent = String(shown.message ?? "");
  picture.alt = `Picture of ${String(shown.name ?? "the scene")}`;
  picture.classList.toggle("stale", message.textContent !== "");
}

function orbit(x: number, y: number): void {
  api.postMessage({ type: "orbit", azimuth_deg: -x, elevation_deg: y });
}

window.addEventListener("message", (event: MessageEvent<Partial<Shown>>) => show(event.data));

picture.addEventListener("pointerdown", (event) => picture.setPointerCapture(event.pointerId));
picture.addEventListener("pointermove", (event) => {
  if (event.buttons & 1) orbit(event.movementX * TURN, event.movementY * TURN);
});
picture.addEventListener(
  "wheel",
  (event) => {
    event.preventDefault();
    const pixels = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? event.deltaY : event.deltaY * 20;
    api.postMessage({ type: "zoom", factor: Math.exp(Math.min(Math.max(pixels, -500), 500) * APPROACH) });
  },
  { passive: false },
);
picture.addEventListener("dblclick", () => api.postMessage({ type: "reset" }));
picture.addEventListener("keydown", (event) => {
  const arrows: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const arrow = arrows[event.key];
  if (arrow) orbit(arrow[0] * STEP_DEG, arrow[1] * STEP_DEG);
  else if (event.key === "+" || event.key === "-") api.postMessage({ type: "zoom", factor: event.key === "+" ? 0.8 : 1.25 });
  else if (event.key === "Home") api.postMessage({ type: "reset" });
  else return;
  event.preventDefault();
});

new ResizeObserver(() => {
  const { clientWidth, clientHeight } = picture;
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  if (clientWidth && clientHeight) api.postMessage({ type: "resize", width: clientWidth * scale, height: clientHeight * scale });
}).observe(picture);

api.postMessage({ type: "ready" });
