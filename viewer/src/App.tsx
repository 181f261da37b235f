// Layout of the page: the show, its check, or every detail.
import { useEffect } from "preact/hooks";
import { Curves } from "./curves/Curves";
import { Margins } from "./margins/Margins";
import { Header } from "./panels/Header";
import { Help } from "./panels/Help";
import { Inspector } from "./panels/Inspector";
import { Splitter } from "./panels/Splitter";
import { Spoken } from "./panels/Spoken";
import { Caption } from "./stage/Caption";
import { Stage } from "./stage/Stage";
import { listenToAddress } from "./state/address";
import { useCell } from "./state/cell";
import { listenToKeys } from "./state/keys";
import { hasStage, SessionContext, type Mode, type Session } from "./state/session";
import { Strip } from "./timeline/Strip";
import { Timeline } from "./timeline/Timeline";

export function App({ session }: { session: Session }) {
  const theme = useCell(session.theme);
  const mode = useCell(session.mode);
  // Before the canvases draw, because they read the colours of the theme.
  document.documentElement.dataset.theme = theme;
  useEffect(() => listenToKeys(session), [session]);
  useEffect(() => listenToAddress(session), [session]);
  const bodies = hasStage(session.show);
  return (
    <SessionContext.Provider value={session}>
      <Header />
      <main key={mode} class={`${mode}-mode ${bodies ? "with-stage" : "without-stage"}`}>
        {PARTS[mode](bodies)}
      </main>
      <Spoken />
      <Help />
    </SessionContext.Provider>
  );
}

const PARTS: Record<Mode, (bodies: boolean) => preact.ComponentChildren> = {
  show: (bodies) => (
    <>
      {bodies ? (
        <div class="hero">
          <Stage hero />
          <Caption />
        </div>
      ) : (
        <p class="no-stage">
          No robot has a place in space, so there is nothing to see here. Add <code>body: {"{x: …, y: …, z: …}"}</code> to the robots of
          the fleet file, or open <b>Check</b> (G).
        </p>
      )}
      <Strip />
    </>
  ),
  check: (bodies) => (
    <>
      <Inspector />
      <Splitter direction="column" />
      {bodies && <Margins />}
      <Timeline />
    </>
  ),
  engineer: (bodies) => (
    <>
      <Inspector />
      <Splitter direction="column" />
      {bodies && <Stage />}
      <Curves />
      <Splitter direction="row" />
      <Timeline />
    </>
  ),
};
