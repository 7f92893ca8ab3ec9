/** What the preview and the language server say to each other, beside the protocol that every editor knows. */

import { NotificationType, RequestType } from "vscode-languageserver-protocol";

/** The picture that is asked for. What is missing is chosen by the server. */
export interface PreviewParams {
  uri: string;
  /** Direction to the camera from the middle of the scene, counterclockwise from x [deg], and its angle above the horizon. */
  azimuth_deg?: number;
  elevation_deg?: number;
  /** Distance from the camera to the middle of the scene [m]. */
  distance?: number;
  /** Size of the picture [px]. */
  width?: number;
  height?: number;
}

export interface PreviewResult {
  /** Version of the text that the picture shows. */
  version: number | null;
  /** A PNG file as base64, or null if there is no picture. */
  png: string | null;
  width: number;
  height: number;
  /** A sentence if the picture does not show the current text, and else empty or null. */
  message: string | null;
  /** Where the camera of the picture is. */
  azimuth_deg?: number;
  elevation_deg?: number;
  distance?: number;
}

export const previewRequest = new RequestType<PreviewParams, PreviewResult | null, void>("simfoundry/preview");

export const previewChanged = new NotificationType<{ uri: string; version: number }>("simfoundry/previewChanged");

/** What the page of the preview tells the extension: gestures, and its size. */
export type PageMessage =
  | { type: "ready" }
  | { type: "orbit"; azimuth_deg: number; elevation_deg: number }
  | { type: "zoom"; factor: number }
  | { type: "reset" }
  | { type: "resize"; width: number; height: number };

/** What the extension tells the page. Without `png`, the page keeps the picture that it has. */
export interface Shown {
  png?: string;
  /** The name of the document. */
  name: string;
  /** A sentence below the picture; empty if the picture shows the current text. */
  message: string;
}

const finite = (value: unknown): value is number => typeof value === "number" && Number.isFinite(value);

/** Return a message of the page, or undefined if it is not one. */
export function pageMessage(value: unknown): PageMessage | undefined {
  const data = (typeof value === "object" && value !== null ? value : {}) as Record<string, unknown>;
  switch (data.type) {
    case "ready":
    case "reset":
      return { type: data.type };
    case "orbit":
      return finite(data.azimuth_deg) && finite(data.elevation_deg)
        ? { type: "orbit", azimuth_deg: data.azimuth_deg, elevation_deg: data.elevation_deg }
        : undefined;
    case "zoom":
      return finite(data.factor) && data.factor > 0 ? { type: "zoom", factor: data.factor } : undefined;
    case "resize":
      return finite(data.width) && finite(data.height) ? { type: "resize", width: data.width, height: data.height } : undefined;
    default:
      return undefined;
  }
}
