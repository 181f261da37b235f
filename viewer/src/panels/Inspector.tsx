// The text panels, one at a time.
import type { ComponentChildren } from "preact";
import { useRef } from "preact/hooks";
import { useCell } from "../state/cell";
import { useSession, type Session, type Tab } from "../state/session";
import { Cues } from "./Cues";
import { Deviations } from "./Deviations";
import { Differences } from "./Differences";
import { Events } from "./Events";
import { Findings } from "./Findings";
import { Source } from "./Source";
import { Summary } from "./Summary";
import { Values } from "./Values";

interface Panel {
  tab: Tab;
  name: string;
  body: () => ComponentChildren;
  count?: (session: Session) => number;
}

const DIFFERENCES: Panel = {
  tab: "differences",
  name: "Differences",
  body: () => <Differences />,
  count: ({ show }) => show.mission.compared?.differences.length ?? 0,
};

const ALWAYS: Panel[] = [
  { tab: "summary", name: "Summary", body: () => <Summary /> },
  { tab: "values", name: "Values", body: () => <Values /> },
  { tab: "cues", name: "Cues", body: () => <Cues /> },
  { tab: "deviations", name: "Deviations", body: () => <Deviations /> },
  { tab: "findings", name: "Findings", body: () => <Findings />, count: ({ show }) => show.mission.findings.length },
  { tab: "events", name: "Events", body: () => <Events /> },
  { tab: "source", name: "Source", body: () => <Source /> },
];

export function Inspector() {
  const session = useSession();
  const current = useCell(session.tab);
  const tabs = session.show.mission.compared ? [...ALWAYS, DIFFERENCES] : ALWAYS;
  const list = useRef<HTMLDivElement>(null);
  const turn = (event: KeyboardEvent) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    const now = tabs.findIndex(({ tab }) => tab === current);
    session.tab.value = tabs[(now + by + tabs.length) % tabs.length].tab;
    requestAnimationFrame(() => list.current?.querySelector<HTMLElement>("[aria-selected=true]")?.focus());
  };
  return (
    <section class="panel inspector" aria-label="Details">
      <div class="tabs" role="tablist" aria-label="Details" ref={list} onKeyDown={turn}>
        {tabs.map(({ tab, name, count }) => (
          <button
            key={tab}
            type="button"
            role="tab"
            id={`tab-${tab}`}
            aria-selected={tab === current}
            aria-controls="tab-body"
            tabIndex={tab === current ? 0 : -1}
            onClick={() => (session.tab.value = tab)}
          >
            {name}
            {count !== undefined && count(session) > 0 && ` ${count(session)}`}
          </button>
        ))}
      </div>
      <div
        id="tab-body"
        key={current}
        class={`tab-body ${current}-tab`}
        role="tabpanel"
        aria-labelledby={`tab-${current}`}
        tabIndex={0}
      >
        {tabs.find(({ tab }) => tab === current)?.body()}
      </div>
    </section>
  );
}
