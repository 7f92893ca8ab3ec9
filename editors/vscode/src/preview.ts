/** The preview of one document at a time: which picture to ask for, and when. Knows nothing of VS Code. */

import type { PageMessage, PreviewParams, PreviewResult, Shown } from "./protocol";

/** From here a table of one meter is seen as a person sees who stands at its corner. */
export const START = { azimuth_deg: 35, elevation_deg: 30 };

/** Steeper, a camera that looks along its own up direction has no defined roll. */
const STEEPEST_DEG = 89;

/** More pixels take longer to render than a person waits, and fewer show nothing [px]. */
const SIZE = { min: 64, max: 1600 };

/** Closer and farther than any scene of a table or a room [m]. */
const DISTANCE = { min: 0.02, max: 1000 };

const within = (value: number, min: number, max: number): number => Math.min(Math.max(value, min), max);

/** What a server answers that does not know a request, by the JSON-RPC specification. */
const METHOD_NOT_FOUND = -32601;

function explanation(error: unknown): string {
  if ((error as { code?: unknown }).code === METHOD_NOT_FOUND) {
    return 'This version of SimFoundry has no preview. Update it with pip install --upgrade "simfoundry[editor]".';
  }
  return `There is no picture: ${error instanceof Error ? error.message : String(error)}`;
}

export type Ask = (params: PreviewParams) => Promise<PreviewResult>;

export class Preview {
  private uri = "";
  private name = "";
  private view: { azimuth_deg: number; elevation_deg: number; distance?: number } = { ...START };
  /** Distance of the picture that is shown, from which the wheel zooms. */
  private shownDistance: number | undefined;
  private zoom = 1;
  private size: { width: number; height: number } | undefined;
  private asking = false;
  private again = false;
  private closed = false;
  private last: Shown | undefined;

  constructor(
    private readonly ask: Ask,
    private readonly show: (shown: Shown) => void,
  ) {}

  /** The document that is shown, or an empty string. */
  get document(): string {
    return this.uri;
  }

  /** Show a document. The view returns to its start if it is another one. */
  follow(uri: string, name: string): void {
    if (uri === this.uri) return;
    [this.uri, this.name, this.last] = [uri, name, undefined];
    this.resetView();
    this.refresh();
  }

  /** Show a document anew, because the server has a new picture of it. */
  changed(uri: string): void {
    if (uri === this.uri) this.refresh();
  }

  /** Do what a person did on the page. */
  receive(message: PageMessage): void {
    switch (message.type) {
      case "ready":
        if (this.last) this.show(this.last);
        break;
      case "orbit":
        this.view.azimuth_deg = (this.view.azimuth_deg + message.azimuth_deg) % 360;
        this.view.elevation_deg = within(this.view.elevation_deg + message.elevation_deg, -STEEPEST_DEG, STEEPEST_DEG);
        break;
      case "zoom":
        this.zoom *= message.factor;
        this.applyZoom();
        break;
      case "reset":
        this.resetView();
        break;
      case "resize":
        this.size = {
          width: Math.round(within(message.width, SIZE.min, SIZE.max)),
          height: Math.round(within(message.height, SIZE.min, SIZE.max)),
        };
    }
    this.refresh();
  }

  /** Ask for the picture again, now or when the request that is under way is answered. */
  refresh(): void {
    if (!this.uri || this.closed) return;
    this.again = true;
    if (!this.asking) void this.work();
  }

  /** Ask no more. */
  close(): void {
    this.closed = true;
  }

  private resetView(): void {
    this.view = { ...START };
    [this.zoom, this.shownDistance] = [1, undefined];
  }

  private applyZoom(): void {
    if (this.shownDistance === undefined || this.zoom === 1) return;
    const from = this.view.distance ?? this.shownDistance;
    this.view.distance = within(from * this.zoom, DISTANCE.min, DISTANCE.max);
    this.zoom = 1;
  }

  private async work(): Promise<void> {
    this.asking = true;
    while (this.again && !this.closed) {
      this.again = false;
      const uri = this.uri;
      let shown: Shown;
      try {
        const result = await this.ask({ uri, ...this.view, ...this.size });
        this.shownDistance = result.distance ?? this.shownDistance;
        shown = { name: this.name, message: result.message, ...(result.png === null ? {} : { png: result.png }) };
      } catch (error) {
        shown = { name: this.name, message: explanation(error) };
      }
      if (uri !== this.uri || this.closed) continue;
      this.last = { ...this.last, ...shown };
      this.show(shown);
      if (this.zoom !== 1 && this.shownDistance !== undefined) {
        this.applyZoom();
        this.again = true;
      }
    }
    this.asking = false;
  }
}
