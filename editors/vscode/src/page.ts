/** The page of the preview. What is shown later comes as data, which the script never parses as markup. */

/** Return the HTML of the page. `script` is the address of its script, and `nonce` is new for each page. */
export function page(script: string, nonce: string): string {
  if (!/^[\w-]{16,}$/.test(nonce) || /["<>\s]/.test(script)) throw new Error("the address or the nonce of the page is malformed");
  const policy = `default-src 'none'; img-src data:; script-src 'nonce-${nonce}'; style-src 'nonce-${nonce}'`;
  return `<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="${policy}">
<title>SimFoundry</title>
<style nonce="${nonce}">
/* The sentence lies over the picture, which would otherwise be asked for in another size. */
html, body { height: 100%; margin: 0; padding: 0; overflow: hidden; }
body { display: flex; flex-direction: column; position: relative; }
#picture { flex: 1; min-height: 0; object-fit: contain; cursor: grab; touch-action: none; outline-offset: -2px; }
#picture:active { cursor: grabbing; }
#picture.stale { opacity: 0.6; }
#message:empty { display: none; }
#message { position: absolute; inset: auto 0 0 0; padding: 4px 10px; white-space: pre-wrap; overflow-y: auto; max-height: 30%;
  color: var(--vscode-inputValidation-warningForeground, var(--vscode-foreground));
  background: var(--vscode-inputValidation-warningBackground);
  border-top: 1px solid var(--vscode-inputValidation-warningBorder); }
#hint { padding: 4px 10px; color: var(--vscode-descriptionForeground); }
</style>
</head>
<body>
<img id="picture" tabindex="0" draggable="false" alt="">
<div id="message" role="status"></div>
<div id="hint">Drag to orbit, scroll to zoom, double-click to return.</div>
<script nonce="${nonce}" src="${script}"></script>
</body>
</html>`;
}
