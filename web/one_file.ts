import { readFileSync } from "node:fs";
import type { BuildOptions, Plugin } from "vite";

/** Where pages are built, until place_build.mjs puts them into dist. */
export const OUT = "dist.new";

/** How a page becomes one file: after the other pages, beside them. */
export const buildOf = (input: string): BuildOptions => ({
  outDir: OUT,
  emptyOutDir: false,
  target: "es2022",
  cssCodeSplit: false,
  modulePreload: false,
  chunkSizeWarningLimit: 5000,
  rolldownOptions: { input, output: { codeSplitting: false } },
});

/** What the bundled packages ask for, as the build of the viewer wrote it, which bundles the same ones. */
function notices(): string {
  return readFileSync(new URL(`${OUT}/licenses.md`, import.meta.url), "utf8");
}

/**
 * Puts scripts and styles into the page that uses them: it is then one file of that name, which a browser opens from disk. `licenses`:
 * of packages that the viewer's own build does not bundle.
 */
export function inOneFile(name: string, licenses: readonly URL[] = []): Plugin {
  return {
    name: "in-one-file",
    enforce: "post",
    generateBundle(_options, bundle) {
      const files = Object.values(bundle);
      const page = files.find((file) => file.fileName.endsWith(".html"));
      if (page?.type !== "asset") throw new Error("the build has no page");
      let html = String(page.source);
      const put = (pattern: RegExp, text: string): void => {
        if (!pattern.test(html)) throw new Error(`the page does not use ${pattern}`);
        html = html.replace(pattern, () => text);
      };
      let script = "";
      for (const file of files) {
        if (file === page) continue;
        const used = `[^>]*(?:src|href)="[^"]*${file.fileName.replaceAll(".", "\\.")}"[^>]*>`;
        if (file.type === "chunk") {
          put(new RegExp(`\\s*<script${used}</script>`), "");
          script = file.code.replaceAll("</script", "<\\/script");
        } else if (file.fileName.endsWith(".css")) {
          put(new RegExp(`<link${used}`), `<style>${String(file.source)}</style>`);
        } else {
          throw new Error(`${file.fileName} is in no page`);
        }
        delete bundle[file.fileName];
      }
      const all = [notices(), ...licenses.map((file) => readFileSync(file, "utf8"))].join("\n");
      html = html.replace("</head>", () => `<!--\n${all.replaceAll("--", "==")}\n    -->\n  </head>`);
      // Behind the recording, which it reads.
      put(/\s*<\/body>/, `\n    <script type="module">${script}</script>\n  </body>`);
      page.source = html;
      page.fileName = name;
    },
  };
}
