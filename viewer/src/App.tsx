// Layout of the page.
import { useEffect } from "preact/hooks";
import { Curves } from "./curves/Curves";
import { Header } from "./panels/Header";
import { Help } from "./panels/Help";
import { Inspector } from "./panels/Inspector";
import { Spoken } from "./panels/Spoken";
import { Stage } from "./stage/Stage";
import { useCell } from "./state/cell";
import { listenToKeys } from "./state/keys";
import { SessionContext, type Session } from "./state/session";
import { Timeline } from "./timeline/Timeline";

export function App({ session }: { session: Session }) {
  const theme = useCell(session.theme);
  // Before the canvases draw, because they read the colours of the theme.
  document.documentElement.dataset.theme = theme;
  useEffect(() => listenToKeys(session), [session]);
  const bodies = session.show.mission.robots.some((robot) => robot.body !== null);
  return (
    <SessionContext.Provider value={session}>
      <Header />
      <main class={bodies ? "with-stage" : "without-stage"}>
        <Inspector />
        {bodies && <Stage />}
        <Curves />
        <Timeline />
      </main>
      <Spoken />
      <Help />
    </SessionContext.Provider>
  );
}
