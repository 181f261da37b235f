// Takes screenshots of the page in three sizes and both themes: `node test/shots.mjs [FOLDER]`.
import { mkdir } from "node:fs/promises";
import { launch, shown, SIZES } from "./browser.mjs";
import { choreography } from "./choreography.mjs";
import { pageWith } from "./encode.mjs";

const folder = process.argv[2] ?? new URL("shots", import.meta.url).pathname;
await mkdir(folder, { recursive: true });
const html = await pageWith((await choreography()).base64);
const browser = await launch();
for (const theme of ["light", "dark"]) {
  for (const [name, size] of Object.entries(SIZES)) {
    const { page, complaints, close } = await browser.open(html, { size, theme });
    await shown(page);
    for (let i = 0; i < 7; i++) await page.keyboard.press("ArrowRight");
    await page.waitForTimeout(600);
    await page.screenshot({ path: `${folder}/${name}-${theme}.png`, fullPage: true });
    if (complaints.length > 0) console.log(name, theme, complaints);
    await close();
  }
}
await browser.close();
