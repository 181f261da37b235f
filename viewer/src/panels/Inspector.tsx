export function Inspector() { return <section class="panel inspector" aria-label="Inspector"></section>; }
