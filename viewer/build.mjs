// Builds `page.html`: one page without any other file, whose policy permits nothing but its own script and style.
import { createHash } from "node:crypto";
import { readFile, writeFile } from "node:fs/promises";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const here = new URL(".", import.meta.url);

const bundle = async (entry) => {
  const result = await build({
    entryPoints: [new URL(entry, here).pathname],
    bundle: true,
    minify: true,
    write: false,
    charset: "ascii",
    legalComments: "none",
    target: ["es2021", "chrome90", "firefox90", "safari15"],
  });
  // `</script` or `</style` inside would end the element.
  return result.outputFiles[0].text.trim().replaceAll("</", "<\\/");
};
const hash = (text) => `'sha256-${createHash("sha256").update(text).digest("base64")}'`;

const [template, script, style] = await Promise.all([
  readFile(new URL("src/page.html", here), "utf8"),
  bundle("src/main.tsx"),
  bundle("src/style/page.css"),
]);
const policy = `default-src 'none'; script-src ${hash(script)}; style-src ${hash(style)}`;
const page = template.replace(
  /@@(POLICY|SCRIPT|STYLE)@@/g,
  (_, name) => ({ POLICY: policy, SCRIPT: script, STYLE: style })[name],
);
await writeFile(new URL("page.html", here), page);
console.log(`page.html: ${page.length} bytes, ${gzipSync(page, { level: 9 }).length} gzipped`);
