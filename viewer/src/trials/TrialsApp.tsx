// The page of trials: how a mission behaves in a world, over many random draws.
import { useEffect, useState } from "preact/hooks";
import { ThemeTool } from "../panels/ThemeTool";
import { Cell, useCell } from "../state/cell";
import { preferredTheme, type Theme } from "../state/session";
import { Name } from "../text/Name";
import type { Trials } from "../trials";
import { Acts } from "./Acts";
import { Lead } from "./Lead";
import { Outcomes } from "./Outcomes";
import { counted } from "./percent";
import { Reasons } from "./Reasons";
import { Required, RequiredBadge } from "./Required";
import { Robots } from "./Robots";
import { Shares } from "./Shares";
import { Spread } from "./Spread";

export function TrialsApp({ trials }: { trials: Trials }) {
  const [theme] = useState(() => new Cell<Theme>(preferredTheme()));
  document.documentElement.dataset.theme = useCell(theme);
  useEffect(() => listen(theme), [theme]);
  const requirements = trials.requirements ?? [];
  return (
    <>
      <header>
        <h1>
          <Name text={trials.scenario} />
        </h1>
        <span class="badge" id="count">
          {counted(trials.trials, "trial")}
        </span>
        <span id="world">
          {trials.world === "" ? (
            "in the world of the fleet file"
          ) : (
            <>
              in the world <Name text={trials.world} />
            </>
          )}
          , seed {trials.seed}
        </span>
        <RequiredBadge requirements={requirements} />
        <span class="gap" />
        <ThemeTool theme={theme} />
      </header>
      <main class="trials">
        <Shares trials={trials} />
        <Required requirements={requirements} />
        <Spread trials={trials} />
        <div class="column">
          <Outcomes outcomes={trials.outcomes} />
          <Lead lead={trials.lead} />
        </div>
        <Reasons trials={trials} />
        <Robots trials={trials} />
        <Acts acts={trials.acts} />
        <p class="hint wide">
          Written by <Name text={trials.program} />. Shares have the 95 % interval of Wilson's score method.
        </p>
      </main>
    </>
  );
}

/** T switches the theme, as on the page of a mission. */
function listen(theme: Cell<Theme>): () => void {
  const press = (event: KeyboardEvent) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.key.toLowerCase() !== "t") return;
    theme.value = theme.value === "dark" ? "light" : "dark";
  };
  document.addEventListener("keydown", press);
  return () => document.removeEventListener("keydown", press);
}
