/** The extension as VS Code loads it: commands, the language client, and the panel beside the text. */

import { randomBytes } from "node:crypto";
import { homedir } from "node:os";
import * as vscode from "vscode";
import { CloseAction, ErrorAction, LanguageClient, State } from "vscode-languageclient/node";

import { type Found, findServer } from "./findServer";
import { page } from "./page";
import { Preview } from "./preview";
import { type PreviewParams, type PreviewResult, pageMessage, previewChanged, previewRequest } from "./protocol";
import { ServerProcess } from "./startServer";

const LANGUAGE = "simfoundry";

/** A server that stops this often is not started again by itself. */
const MOST_STARTS = 4;

/** The part of the Python extension's interface that is used here. */
interface PythonExtension {
  environments: {
    getActiveEnvironmentPath(folder?: vscode.Uri): { path: string };
    onDidChangeActiveEnvironmentPath: vscode.Event<unknown>;
  };
}

/** A client that leaves it to the extension to show why the server does not start, once and as a sentence. */
class Client extends LanguageClient {
  override error(message: string, data?: unknown): void {
    super.error(message, data, false);
  }
}

class Server {
  private client: Client | undefined;
  private process: ServerProcess | undefined;
  private starts = 0;
  private turn: Promise<void> = Promise.resolve();
  private readonly changedPreview = new vscode.EventEmitter<string>();
  /** Fires with the URI of a document whose picture has changed, or with an empty string if the server is a new one. */
  readonly onPreview = this.changedPreview.event;

  constructor(
    private readonly output: vscode.OutputChannel,
    private readonly python: PythonExtension | undefined,
  ) {}

  /** Return the program, or a sentence on what to do. */
  find(): Found {
    const folders = (vscode.workspace.workspaceFolders ?? []).filter((each) => each.uri.scheme === "file");
    return findServer({
      setting: vscode.workspace.getConfiguration(LANGUAGE).get("path", ""),
      folders: folders.map((each) => each.uri.fsPath),
      python: this.python?.environments.getActiveEnvironmentPath(folders[0]?.uri).path,
      env: process.env,
      home: homedir(),
      platform: process.platform,
    });
  }

  /** Start the server, or start it anew. Calls are carried out one after the other. */
  restart(): Promise<void> {
    this.turn = this.turn.then(async () => {
      await this.stopNow();
      this.starts = 0;
      if (vscode.workspace.isTrusted) await this.startNow();
    });
    return this.turn;
  }

  /** Stop the server. */
  stop(): Promise<void> {
    this.turn = this.turn.then(() => this.stopNow());
    return this.turn;
  }

  /** Return the picture of a document. */
  preview(params: PreviewParams): Promise<PreviewResult | null> {
    if (this.client?.state !== State.Running) {
      return Promise.reject(new Error("the language server is not running. Run SimFoundry: Restart server."));
    }
    return this.client.sendRequest(previewRequest, params);
  }

  private async startNow(): Promise<void> {
    const found = this.find();
    if ("missing" in found) return this.complain(found.missing);
    const folder = vscode.workspace.workspaceFolders?.[0]?.uri;
    const log = (text: string): void => this.output.append(text);
    const client: Client = new Client(
      LANGUAGE,
      "SimFoundry",
      async () => {
        this.starts += 1;
        this.process = await ServerProcess.start(found.command, folder?.scheme === "file" ? folder.fsPath : undefined, log);
        return this.process.process;
      },
      {
        documentSelector: [{ language: LANGUAGE, scheme: "file" }, { language: LANGUAGE, scheme: "untitled" }],
        outputChannel: this.output,
        initializationFailedHandler: () => false, // `complain` says why, once
        errorHandler: {
          error: () => ({ action: ErrorAction.Continue, handled: true }),
          closed: async () => {
            if (this.client !== client) return { action: CloseAction.DoNotRestart, handled: true };
            const restart = client.state === State.Running && this.starts < MOST_STARTS;
            if (!restart && this.process) this.complain(await this.process.lastWords());
            return { action: restart ? CloseAction.Restart : CloseAction.DoNotRestart, handled: true };
          },
        },
      },
    );
    client.onNotification(previewChanged, ({ uri }) => this.changedPreview.fire(uri));
    client.onDidChangeState(({ newState }) => {
      if (newState === State.Running) this.changedPreview.fire("");
    });
    this.client = client;
    try {
      await client.start();
    } catch (error) {
      if (!this.process) this.complain(error instanceof Error ? error.message : String(error));
    }
  }

  private async stopNow(): Promise<void> {
    const [client, server] = [this.client, this.process];
    [this.client, this.process] = [undefined, undefined];
    try {
      if (client?.needsStop()) await client.stop();
    } catch {
      // It did not answer; its process is ended below.
    }
    await client?.dispose().catch(() => undefined);
    server?.process.kill();
  }

  private complain(sentence: string): void {
    this.output.appendLine(sentence);
    void vscode.window.showErrorMessage(sentence, "Open settings", "Show output", "Try again").then((choice) => {
      if (choice === "Open settings") void vscode.commands.executeCommand("workbench.action.openSettings", "simfoundry.path");
      if (choice === "Show output") this.output.show();
      if (choice === "Try again") void this.restart();
    });
  }
}

/** The panel beside the text, which follows the document that is edited. */
class Panel {
  private panel: vscode.WebviewPanel | undefined;
  private preview: Preview | undefined;

  constructor(
    private readonly server: Server,
    private readonly extension: vscode.Uri,
  ) {
    server.onPreview((uri) => (uri ? this.preview?.changed(uri) : this.preview?.refresh()));
    vscode.window.onDidChangeActiveTextEditor((editor) => this.follow(editor));
    vscode.languages.onDidChangeDiagnostics(({ uris }) => {
      // The server tells of new pictures only; while there are errors, the sentence below the picture changes.
      if (uris.some((uri) => uri.toString() === this.preview?.document && firstError(uri))) this.preview?.refresh();
    });
  }

  /** Show the document of the active editor. */
  open(): void {
    const editor = vscode.window.activeTextEditor;
    if (editor?.document.languageId !== LANGUAGE) {
      void vscode.window.showInformationMessage("Open a scene, such as desk.scene.yaml, to show it.");
      return;
    }
    if (this.panel) this.panel.reveal(undefined, true);
    else this.create();
    this.follow(editor);
  }

  private follow(editor: vscode.TextEditor | undefined): void {
    if (!this.panel || editor?.document.languageId !== LANGUAGE) return;
    const name = vscode.workspace.asRelativePath(editor.document.uri, false);
    this.panel.title = `Scene ${name.split("/").at(-1)}`;
    this.preview?.follow(editor.document.uri.toString(), name);
  }

  private create(): void {
    const column = { viewColumn: vscode.ViewColumn.Beside, preserveFocus: true };
    const options = { enableScripts: true, localResourceRoots: [this.extension], retainContextWhenHidden: true };
    const panel = vscode.window.createWebviewPanel("simfoundry.scene", "Scene", column, options);
    const preview = new Preview(
      (params) => this.server.preview(params),
      (shown) => void panel.webview.postMessage(shown),
      (uri) => firstError(vscode.Uri.parse(uri)),
    );
    panel.webview.onDidReceiveMessage((data: unknown) => {
      const message = pageMessage(data);
      if (message) preview.receive(message);
    });
    panel.onDidDispose(() => {
      preview.close();
      [this.panel, this.preview] = [undefined, undefined];
    });
    const script = panel.webview.asWebviewUri(vscode.Uri.joinPath(this.extension, "page.js"));
    panel.webview.html = page(script.toString(), randomBytes(18).toString("base64url"));
    [this.panel, this.preview] = [panel, preview];
  }
}

/** Return the first error of a document as a sentence, or an empty string. */
function firstError(uri: vscode.Uri): string {
  const errors = vscode.languages.getDiagnostics(uri).filter((each) => each.severity === vscode.DiagnosticSeverity.Error);
  const first = errors.sort((a, b) => a.range.start.compareTo(b.range.start))[0];
  return first ? `Line ${first.range.start.line + 1}: ${first.message}` : "";
}

/** Return the task that checks a folder; its findings in files that are not open go to the list of problems. */
function checkTask(server: Server, folder: vscode.WorkspaceFolder): vscode.Task | undefined {
  const found = server.find();
  if ("missing" in found) return undefined;
  const run = new vscode.ProcessExecution(found.command, ["check", "."], { cwd: folder.uri.fsPath });
  return new vscode.Task({ type: LANGUAGE }, folder, "check", "SimFoundry", run, ["$simfoundry"]);
}

async function checkProject(server: Server): Promise<void> {
  const active = vscode.window.activeTextEditor?.document.uri;
  const folder = (active && vscode.workspace.getWorkspaceFolder(active)) ?? vscode.workspace.workspaceFolders?.[0];
  if (!folder || !vscode.workspace.isTrusted) {
    void vscode.window.showInformationMessage("Open the folder of your project, and trust it, to check it.");
    return;
  }
  const task = checkTask(server, folder);
  if (task) await vscode.tasks.executeTask(task);
  else await server.restart(); // says what is missing
}

let server: Server | undefined;

/** Start the server and register what the extension offers. */
export async function activate(context: vscode.ExtensionContext): Promise<void> {
  const output = vscode.window.createOutputChannel("SimFoundry");
  const python = await pythonExtension();
  const running = (server = new Server(output, python));
  const panel = new Panel(running, context.extensionUri);
  const { registerCommand } = vscode.commands;
  context.subscriptions.push(
    output,
    registerCommand("simfoundry.showScene", () => panel.open()),
    registerCommand("simfoundry.checkProject", () => checkProject(running)),
    registerCommand("simfoundry.restartServer", () => running.restart()),
    vscode.workspace.onDidGrantWorkspaceTrust(() => running.restart()),
    vscode.workspace.onDidChangeConfiguration((change) => {
      if (change.affectsConfiguration("simfoundry.path")) void running.restart();
    }),
    vscode.tasks.registerTaskProvider(LANGUAGE, {
      provideTasks: () => (vscode.workspace.workspaceFolders ?? []).flatMap((folder) => checkTask(running, folder) ?? []),
      resolveTask: () => undefined,
    }),
  );
  if (python) context.subscriptions.push(python.environments.onDidChangeActiveEnvironmentPath(() => running.restart()));
  void running.restart();
}

/** Stop the server. */
export async function deactivate(): Promise<void> {
  await server?.stop();
}

/** Return the interface of the Python extension, which knows the selected environment, if it is installed. */
async function pythonExtension(): Promise<PythonExtension | undefined> {
  try {
    return await vscode.extensions.getExtension<PythonExtension>("ms-python.python")?.activate();
  } catch {
    return undefined;
  }
}
