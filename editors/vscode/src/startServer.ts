/** The process of the language server. Knows nothing of VS Code. */

import { type ChildProcessWithoutNullStreams, spawn } from "node:child_process";
import { basename } from "node:path";

import { INSTALL } from "./findServer";

/** Of what a server writes about itself, the end is enough to see why it stopped [characters]. */
const KEPT = 4000;

/** A process that has closed its output ends within this time, or something else keeps its pipes open. */
const PATIENCE_MS = 2000;

export class ServerProcess {
  readonly process: ChildProcessWithoutNullStreams;
  private words = "";
  private failure: string | undefined;
  private readonly ended: Promise<void>;

  private constructor(
    private readonly command: string,
    folder: string | undefined,
    log: (text: string) => void,
  ) {
    this.process = spawn(command, ["lsp"], { cwd: folder, stdio: "pipe", windowsHide: true });
    this.process.stderr.setEncoding("utf8").on("data", (text: string) => {
      this.words = (this.words + text).slice(-KEPT);
      log(text);
    });
    this.process.on("error", (error) => (this.failure = error.message));
    this.ended = new Promise((resolve) => this.process.once("close", () => resolve()));
    // A server that ends before it has read everything is reported by `explanation`, not by its pipe.
    this.process.stdin.on("error", () => {});
  }

  /** Start `simfoundry lsp`, which reads and writes the protocol on its standard input and output. */
  static async start(command: string, folder: string | undefined, log: (text: string) => void): Promise<ServerProcess> {
    const server = new ServerProcess(command, folder, log);
    await new Promise<void>((resolve, reject) => {
      server.process.once("spawn", resolve);
      server.process.once("error", () => reject(new Error(server.explanation())));
    });
    return server;
  }

  /** Return a sentence on why the server stopped, when everything that it wrote has arrived. */
  async lastWords(): Promise<string> {
    await Promise.race([this.ended, new Promise((resolve) => setTimeout(resolve, PATIENCE_MS).unref())]);
    return this.explanation();
  }

  private explanation(): string {
    const lines = this.words.split("\n").map((line) => line.trim()).filter(Boolean);
    const kept = this.words.includes("Traceback (most recent call last)") ? 1 : 2;
    const said = this.failure ?? lines.slice(-kept).join(" ");
    if (/No such command/.test(said)) {
      return `${this.command} has no language server because it is too old. Update it with ${INSTALL}.`;
    }
    const reason = said ? `: ${said.replace(/\.$/, "")}.` : ".";
    const advice = said.includes("simfoundry[editor]") ? "" : ` If a package is missing, install it with ${INSTALL}.`;
    return `The language server (${basename(this.command)} lsp) stopped${reason}${advice}`;
  }
}
