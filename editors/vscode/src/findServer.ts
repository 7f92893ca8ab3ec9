/** Where the program `simfoundry` is. Knows nothing of VS Code. */

import { accessSync, constants, statSync } from "node:fs";
import { posix, win32 } from "node:path";

export const INSTALL = 'pip install "simfoundry[editor]"';

/** Where to look. */
export interface Places {
  /** The setting `simfoundry.path`; empty if it is not set. */
  setting: string;
  /** The folders of the workspace. */
  folders: readonly string[];
  /** The Python environment that is selected in the workspace: its folder, or its interpreter. */
  python: string | undefined;
  env: Readonly<Record<string, string | undefined>>;
  home: string;
  platform: NodeJS.Platform;
}

export type Found = { command: string } | { missing: string };

/** Return the program that a setting names, or the first one in the places to look, or a sentence on what to do. */
export function findServer(places: Places, isProgram: (path: string) => boolean = isProgramFile): Found {
  if (places.setting.trim()) {
    const named = expanded(places.setting.trim(), places);
    if (named.some(isProgram)) return { command: named.find(isProgram)! };
    return {
      missing: `The setting simfoundry.path names ${named[0]}, which is not a program. Correct or clear it; ${INSTALL} installs SimFoundry with its language server.`,
    };
  }
  const command = candidates(places).find(isProgram);
  if (command) return { command };
  return {
    missing: `SimFoundry was not found in the selected Python environment, in .venv, or on the PATH. Install it with ${INSTALL}, or name it in the setting simfoundry.path.`,
  };
}

/** Return every place where the program may be, the first one first. */
export function candidates(places: Places): string[] {
  const windows = places.platform === "win32";
  const path = windows ? win32 : posix;
  const [bin, program] = windows ? ["Scripts", "simfoundry.exe"] : ["bin", "simfoundry"];
  const out: string[] = [];
  if (places.python) out.push(path.join(places.python, bin, program), path.join(path.dirname(places.python), program));
  for (const folder of places.folders) for (const venv of [".venv", "venv"]) out.push(path.join(folder, venv, bin, program));
  for (const root of [places.env.VIRTUAL_ENV, places.env.CONDA_PREFIX]) if (root) out.push(path.join(root, bin, program));
  const listed = (places.env.PATH ?? places.env.Path ?? "").split(path.delimiter);
  for (const folder of listed) if (path.isAbsolute(folder)) out.push(path.join(folder, program));
  return [...new Set(out)];
}

function expanded(setting: string, places: Places): string[] {
  const path = places.platform === "win32" ? win32 : posix;
  const text = setting.replace(/^~(?=[\\/]|$)/, () => places.home);
  const folders = places.folders.length ? places.folders : [places.home];
  return [...new Set(folders.map((folder) => path.resolve(folder, text.replaceAll("${workspaceFolder}", () => folder))))];
}

function isProgramFile(path: string): boolean {
  try {
    accessSync(path, constants.X_OK);
    return statSync(path).isFile();
  } catch {
    return false;
  }
}
