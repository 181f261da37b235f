export function Stage() { return <section class="panel stage" aria-label="Stage"></section>; }
