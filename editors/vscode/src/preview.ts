/** The preview of one document at a time: which picture to ask for, and when. Knows nothing of VS Code. */

import type { PageMessage, PreviewParams, PreviewResult, Shown } from "./protocol";

/** Steeper, a camera that looks along its own up direction has no defined roll. */
const STEEPEST_DEG = 89;

/** More pixels take longer to render than a person waits, and fewer show nothing [px]. */
const SIZE = { min: 64, max: 1600 };

/** Height of a picture by its width. The server fits the scene into the height, so a taller picture would cut off its sides. */
const TALLEST = 3 / 4;

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

export type Ask = (params: PreviewParams) => Promise<PreviewResult | null>;

/** Where the camera is: what a person has chosen, and else what the server chose. */
interface View {
  azimuth_deg?: number;
  elevation_deg?: number;
  distance?: number;
}

export class Preview {
  private uri = "";
  private name = "";
  private chosen: View = {};
  private shown: View = {};
  /** What a person has done since the last picture, while it was not known where the camera is. */
  private pending = { azimuth_deg: 0, elevation_deg: 0, factor: 1 };
  private size: { width: number; height: number } | undefined;
  private asking = false;
  private again = false;
  private closed = false;
  private last: Shown | undefined;

  /**
   * @param ask Asks the server for a picture.
   * @param show Shows a picture, or the sentence without one.
   * @param finding Returns the first error of a document as a sentence, or an empty string.
   */
  constructor(
    private readonly ask: Ask,
    private readonly show: (shown: Shown) => void,
    private readonly finding: (uri: string) => string = () => "",
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
        this.pending.azimuth_deg += message.azimuth_deg;
        this.pending.elevation_deg += message.elevation_deg;
        this.move();
        break;
      case "zoom":
        this.pending.factor *= message.factor;
        this.move();
        break;
      case "reset":
        this.resetView();
        break;
      case "resize":
        this.size = {
          width: Math.round(within(message.width, SIZE.min, SIZE.max)),
          height: Math.round(within(Math.min(message.height, message.width * TALLEST), SIZE.min, SIZE.max)),
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
    [this.chosen, this.shown] = [{}, {}];
    this.pending = { azimuth_deg: 0, elevation_deg: 0, factor: 1 };
  }

  /** Move the camera as a person has asked, from where it is. Returns whether it moved. */
  private move(): boolean {
    const { azimuth_deg, elevation_deg, distance } = { ...this.shown, ...this.chosen };
    const { pending } = this;
    if (azimuth_deg === undefined || elevation_deg === undefined || distance === undefined) return false;
    if (!pending.azimuth_deg && !pending.elevation_deg && pending.factor === 1) return false;
    this.chosen = {
      azimuth_deg: (azimuth_deg + pending.azimuth_deg) % 360,
      elevation_deg: within(elevation_deg + pending.elevation_deg, -STEEPEST_DEG, STEEPEST_DEG),
      distance: within(distance * pending.factor, DISTANCE.min, DISTANCE.max),
    };
    this.pending = { azimuth_deg: 0, elevation_deg: 0, factor: 1 };
    return true;
  }

  private async work(): Promise<void> {
    this.asking = true;
    while (this.again && !this.closed) {
      this.again = false;
      const uri = this.uri;
      let shown: Shown;
      try {
        const result = await this.ask({ uri, ...this.chosen, ...this.size });
        if (uri !== this.uri) continue;
        shown = { name: this.name, message: this.sentence(result) };
        if (result?.png) shown.png = result.png;
        const { azimuth_deg, elevation_deg, distance } = result ?? {};
        if (azimuth_deg !== undefined) this.shown = { azimuth_deg, elevation_deg, distance };
      } catch (error) {
        shown = { name: this.name, message: explanation(error) };
      }
      if (uri !== this.uri || this.closed) continue;
      this.last = { ...this.last, ...shown };
      this.show(shown);
      this.again = this.move() || this.again;
    }
    this.asking = false;
  }

  private sentence(result: PreviewResult | null): string {
    const message = result?.message ?? (result?.png ? "" : "There is no picture of this document.");
    return message && [message, this.finding(this.uri)].filter(Boolean).join("\n");
  }
}
