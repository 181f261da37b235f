// Reads the mission or the trials from the page and shows them, or reports why that is impossible.
import { render } from "preact";
import { App } from "./App";
import { isOfTrials, PayloadError, readPayload } from "./data/payload";
import { Show } from "./data/show";
import { Session } from "./state/session";
import { applyAddress } from "./state/address";
import { playAtFirst, runPlayback } from "./state/playback";
import { visible } from "./text/visible";
import { TrialsApp } from "./trials/TrialsApp";

document.addEventListener("DOMContentLoaded", () => void start());

async function start(): Promise<void> {
  const page = document.getElementById("page");
  if (page === null) return;
  try {
    const holder = document.getElementById("mission");
    const base64 = holder?.textContent ?? "";
    // The text is as large as the file and no longer needed.
    holder?.remove();
    const payload = await readPayload(base64);
    document.title = `${visible(payload.mission.scenario)} – Downbeat`;
    if (isOfTrials(payload)) {
      page.replaceChildren();
      render(<TrialsApp trials={payload.mission} />, page);
      return;
    }
    const session = new Session(new Show(payload));
    runPlayback(session);
    const placed = applyAddress(session, location.hash);
    if (!placed && session.mode.value === "show") playAtFirst(session);
    page.replaceChildren();
    render(<App session={session} />, page);
  } catch (error) {
    page.replaceChildren(notice(error));
  }
}

function notice(error: unknown): HTMLElement {
  const paragraph = document.createElement("p");
  paragraph.className = "notice";
  paragraph.setAttribute("role", "alert");
  paragraph.textContent = error instanceof PayloadError ? error.message : `This mission cannot be shown: ${String(error)}`;
  return paragraph;
}
