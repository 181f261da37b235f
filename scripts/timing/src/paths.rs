//! Longest paths from the origin, and the positive cycles that make them impossible.

/// Label of the implicit arc that keeps an event from being earlier than the origin.
pub(super) const IMPLICIT: usize = usize::MAX;
/// Time of a node that no path reaches.
pub(super) const UNREACHED: i64 = i64::MIN;

/// Arcs to >= from + weight, grouped by their start node.
#[derive(Clone, Debug)]
pub(super) struct Arcs {
    /// Index in `arcs` of the first arc of each node; one more entry marks the end.
    first: Vec<u32>,
    arcs: Vec<Arc>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Arc {
    pub(super) from: u32,
    pub(super) to: u32,
    pub(super) weight: i64,
    /// Twice the constraint's index, plus one for the constraint's upper bound; or [`IMPLICIT`].
    pub(super) label: usize,
}

impl Arcs {
    /// Groups arcs, given as (from, to, weight, label), by their start node.
    #[expect(clippy::cast_possible_truncation, reason = "petgraph's indices are u32")]
    pub(super) fn new(nodes: usize, arcs: impl Iterator<Item = (usize, usize, i64, usize)> + Clone) -> Self {
        let mut first = vec![0u32; nodes + 1];
        for (from, ..) in arcs.clone() {
            first[from + 1] += 1;
        }
        for node in 0..nodes {
            first[node + 1] += first[node];
        }
        let none = Arc { from: 0, to: 0, weight: 0, label: IMPLICIT };
        let mut sorted = vec![none; first[nodes] as usize];
        let mut next = first.clone();
        for (from, to, weight, label) in arcs {
            sorted[next[from] as usize] = Arc { from: from as u32, to: to as u32, weight, label };
            next[from] += 1;
        }
        Self { first, arcs: sorted }
    }

    pub(super) fn nodes(&self) -> usize {
        self.first.len() - 1
    }

    pub(super) fn all(&self) -> &[Arc] {
        &self.arcs
    }

    fn range(&self, node: usize) -> std::ops::Range<usize> {
        self.first[node] as usize..self.first[node + 1] as usize
    }

    pub(super) fn of(&self, node: usize) -> &[Arc] {
        &self.arcs[self.range(node)]
    }
}

impl Arc {
    /// Returns the time that the arc requires for its end node, if that is later than the current one in `times`.
    pub(super) fn raises(&self, times: &[i64]) -> Option<i64> {
        let from = times[self.from as usize];
        let asked = from.saturating_add(self.weight);
        (from != UNREACHED && asked > times[self.to as usize]).then_some(asked)
    }
}

impl Arc {
    /// Whether a later time of the arc's start node also makes its end node later.
    fn leads_on(&self, times: &[i64]) -> bool {
        let from = times[self.from as usize];
        from != UNREACHED && from.saturating_add(self.weight) >= times[self.to as usize]
    }
}

/// Returns the least times at or above `times` that satisfy every arc, or the arcs of a positive cycle.
///
/// Uses the method of Goldberg and Radzik. Each pass sorts the nodes that active nodes reach over violated and tight arcs, and relaxes
/// them in topological order. A cycle of such arcs that contains a violated one is positive. So is a cycle of arcs that were the last to
/// raise their end nodes (Cherkassky and Goldberg, Mathematical Programming 85, 1999). If any positive cycle exists, one of these two
/// kinds appears.
pub(super) fn longest(arcs: &Arcs, mut times: Vec<i64>) -> Result<Vec<i64>, Vec<Arc>> {
    let nodes = arcs.nodes();
    let mut search = Search { state: vec![State::New; nodes], stack: Vec::new(), order: Vec::new() };
    let mut raised_by: Vec<Option<Arc>> = vec![None; nodes];
    let mut raises = 0;
    let mut queued = vec![true; nodes];
    let mut active: Vec<u32> = (0..u32::try_from(nodes).unwrap_or(u32::MAX)).collect();
    while !active.is_empty() {
        for node in active.drain(..) {
            queued[node as usize] = false;
            let works = |arc: &Arc| arc.raises(&times).is_some();
            if search.state[node as usize] == State::New && arcs.of(node as usize).iter().any(works) {
                search.visit(arcs, &times, node)?;
            }
        }
        // The node that was finished last comes first.
        for &node in search.order.iter().rev() {
            search.state[node as usize] = State::New;
            for arc in arcs.of(node as usize) {
                if let Some(later) = arc.raises(&times) {
                    times[arc.to as usize] = later;
                    raised_by[arc.to as usize] = Some(*arc);
                    raises += 1;
                    if search.state[arc.to as usize] == State::New && !queued[arc.to as usize] {
                        // The node is not ahead in this pass: the next pass visits it again.
                        queued[arc.to as usize] = true;
                        active.push(arc.to);
                    }
                }
            }
        }
        search.order.clear();
        // Checking all nodes after this many raises costs no more than the raises themselves.
        if raises >= nodes {
            raises = 0;
            if let Some(cycle) = cycle_of(&raised_by) {
                return Err(cycle);
            }
        }
    }
    Ok(times)
}

/// Finds a cycle among the arcs that last raised their end nodes.
fn cycle_of(raised_by: &[Option<Arc>]) -> Option<Vec<Arc>> {
    // Start of the walk that visited each node.
    let mut seen = vec![usize::MAX; raised_by.len()];
    for start in 0..raised_by.len() {
        let mut node = start;
        while seen[node] == usize::MAX {
            seen[node] = start;
            match raised_by[node] {
                Some(arc) => node = arc.from as usize,
                None => break,
            }
        }
        if seen[node] == start && raised_by[node].is_some() {
            let mut cycle = Vec::new();
            let mut at = node;
            while let Some(arc) = raised_by[at] {
                cycle.push(arc);
                at = arc.from as usize;
                if at == node {
                    cycle.reverse();
                    return Some(cycle);
                }
            }
        }
    }
    None
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    New,
    Open,
    Closed,
}

/// Depth-first search over violated and tight arcs, without recursion.
struct Search {
    state: Vec<State>,
    /// Each open node, with the number of its arcs already followed.
    stack: Vec<(u32, u32)>,
    /// Nodes in the order in which they were finished.
    order: Vec<u32>,
}

impl Search {
    fn visit(&mut self, arcs: &Arcs, times: &[i64], root: u32) -> Result<(), Vec<Arc>> {
        self.stack.push((root, 0));
        self.state[root as usize] = State::Open;
        while let Some((node, followed)) = self.stack.last_mut() {
            let out = arcs.of(*node as usize);
            let Some(arc) = out.get(*followed as usize) else {
                self.state[*node as usize] = State::Closed;
                self.order.push(*node);
                self.stack.pop();
                continue;
            };
            *followed += 1;
            if !arc.leads_on(times) {
                continue;
            }
            match self.state[arc.to as usize] {
                State::New => {
                    self.state[arc.to as usize] = State::Open;
                    self.stack.push((arc.to, 0));
                }
                State::Open => {
                    let cycle = self.cycle(arcs, arc.to);
                    if cycle.iter().any(|arc| arc.raises(times).is_some()) {
                        return Err(cycle);
                    }
                }
                State::Closed => {}
            }
        }
        Ok(())
    }

    /// Returns the arcs on the stack from `node` to the top; together they form a cycle.
    fn cycle(&self, arcs: &Arcs, node: u32) -> Vec<Arc> {
        let begin = self.stack.iter().position(|(open, _)| *open == node).unwrap_or(0);
        let followed = |&(node, followed): &(u32, u32)| arcs.of(node as usize)[followed as usize - 1];
        self.stack[begin..].iter().map(followed).collect()
    }
}
