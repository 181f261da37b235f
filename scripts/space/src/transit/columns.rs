//! The columns of an assignment in a k-d tree, which is searched for the cheapest columns of a row. A cost is the price of the distance
//! plus the column's own price.
//!
//! Columns are places, followed by one column for each surplus start. The cost of such an extra column depends on the row alone.

use super::assignment::Price;
use crate::formation::{Point, metres_between};

/// Maximum number of columns per leaf.
const LEAF: usize = 16;

/// A bidder for a column: a start, or an extra row that takes an unused place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    /// Position of the start; `None` for an extra row, which takes an unused place at no cost.
    pub(super) at: Option<Point>,
    /// Distance that the start moves if it gets no place, in metres.
    pub(super) left_over: f64,
}

/// The cost of distances: 1 for the longest possible distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cost {
    price: Price,
    per_metre: f64,
}

impl Cost {
    /// Creates costs from prices. `unit` is the distance that costs 1, in metres.
    pub(super) fn new(price: Price, unit: f64) -> Self {
        Self { price, per_metre: if unit > 0.0 { 1.0 / unit } else { 0.0 } }
    }

    /// Returns the cost of a distance in metres; infinite if the distance exceeds the longest permitted one.
    pub(super) fn of(&self, way: f64) -> f64 {
        if way > self.price.longest {
            return f64::INFINITY;
        }
        let share = way * self.per_metre;
        // Products and square roots are the same on every machine, unlike powers.
        match self.price.sixteenths {
            0 => share,
            16.. => share * share,
            sixteenths => {
                let (mut value, mut root) = (share, share);
                for bit in [8, 4, 2, 1] {
                    root = root.sqrt();
                    if sixteenths & bit != 0 {
                        value *= root;
                    }
                }
                value
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Extent {
    /// The least and the largest coordinates of places.
    Box([Point; 2]),
    LeftOver,
    /// A node with places and with columns for surplus starts.
    Both,
}

struct Node {
    extent: Extent,
    /// Range of the node's columns, as positions in the order of the tree.
    from: usize,
    to: usize,
    /// Index of the second child; the first child follows the node itself. `None` for a leaf.
    second: Option<usize>,
    parent: Option<usize>,
    /// Lowest price of the node's columns.
    price: f64,
}

/// Columns with their prices, which start at 0. An infinite price removes a column.
pub(super) struct Columns {
    nodes: Vec<Node>,
    /// Column at each position of the tree.
    order: Vec<usize>,
    /// Positions of places in space, in the order of the tree.
    points: Vec<Point>,
    prices: Vec<f64>,
    /// Index of the leaf that contains each position of the tree.
    leaves: Vec<usize>,
    /// Number of comparisons of columns with rows so far.
    pub(super) compared: u64,
}

impl Columns {
    /// Builds the tree of places, followed by `left_over` columns for surplus starts. At least one column is required.
    pub(super) fn new(places: &[Point], left_over: usize) -> Self {
        let count = places.len() + left_over;
        let mut columns = Self {
            nodes: Vec::new(),
            order: (0..count).collect(),
            points: Vec::new(),
            prices: vec![0.0; count],
            leaves: vec![0; count],
            compared: 0,
        };
        if left_over > 0 && !places.is_empty() {
            columns.nodes.push(Node {
                extent: Extent::Both,
                from: 0,
                to: count,
                second: None,
                parent: None,
                price: 0.0,
            });
            columns.build(places, 0, places.len(), Some(0));
            columns.nodes[0].second = Some(columns.build(places, places.len(), count, Some(0)));
        } else {
            columns.build(places, 0, count, None);
        }
        columns.points = columns.order.iter().filter_map(|column| places.get(*column)).copied().collect();
        columns
    }

    fn build(&mut self, places: &[Point], from: usize, to: usize, parent: Option<usize>) -> usize {
        let index = self.nodes.len();
        let points = self.order[from..to].iter().filter_map(|column| places.get(*column));
        let bounds = points.fold(None, |bounds: Option<[Point; 2]>, point| {
            let [least, most] = bounds.unwrap_or([*point; 2]);
            Some([
                std::array::from_fn(|axis| least[axis].min(point[axis])),
                std::array::from_fn(|axis| most[axis].max(point[axis])),
            ])
        });
        let extent = bounds.map_or(Extent::LeftOver, Extent::Box);
        self.nodes.push(Node { extent, from, to, second: None, parent, price: 0.0 });
        if to - from <= LEAF {
            self.leaves[from..to].fill(index);
            return index;
        }
        let middle = usize::midpoint(from, to);
        if let Some([least, most]) = bounds {
            let length = |axis: &usize| most[*axis] - least[*axis];
            let axis = (0..3).max_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or(0);
            self.order[from..to].select_nth_unstable_by(middle - from, |a, b| {
                places[*a][axis].total_cmp(&places[*b][axis]).then(a.cmp(b))
            });
        }
        self.build(places, from, middle, Some(index));
        let second = self.build(places, middle, to, Some(index));
        self.nodes[index].second = Some(second);
        index
    }

    pub(super) fn count(&self) -> usize {
        self.order.len()
    }

    /// Returns the column at a position of the tree.
    pub(super) fn column(&self, position: usize) -> usize {
        self.order[position]
    }

    pub(super) fn price(&self, position: usize) -> f64 {
        self.prices[position]
    }

    pub(super) fn set_price(&mut self, position: usize, price: f64) {
        self.prices[position] = price;
        let mut next = Some(self.leaves[position]);
        while let Some(index) = next {
            let least = self.lowest(index);
            if least == self.nodes[index].price {
                return;
            }
            self.nodes[index].price = least;
            next = self.nodes[index].parent;
        }
    }

    /// Returns the lowest price of a node's columns. The prices of its children must be current.
    fn lowest(&self, index: usize) -> f64 {
        let node = &self.nodes[index];
        node.second.map_or_else(
            || self.prices[node.from..node.to].iter().copied().fold(f64::INFINITY, f64::min),
            |second| self.nodes[index + 1].price.min(self.nodes[second].price),
        )
    }

    /// Sets the price of each column; `price` receives the column's position.
    pub(super) fn set_prices(&mut self, price: impl Fn(usize) -> f64) {
        self.prices.iter_mut().enumerate().for_each(|(position, old)| *old = price(position));
        for index in (0..self.nodes.len()).rev() {
            self.nodes[index].price = self.lowest(index);
        }
    }

    /// Returns the distance of a row to the column at a position, in metres.
    pub(super) fn way(&self, row: &Row, position: usize) -> f64 {
        let Some(at) = row.at else { return 0.0 };
        self.points.get(position).map_or(row.left_over, |point| metres_between(at, *point))
    }

    /// Finds the columns with the lowest cost for a row, including prices. Writes costs and positions to `found`, by increasing cost. If
    /// there are too few columns, the remaining costs are infinite.
    pub(super) fn cheapest(&mut self, row: &Row, cost: Cost, found: &mut [(f64, usize)]) {
        found.fill((f64::INFINITY, 0));
        self.search(0, row, cost, found);
    }

    fn search(&mut self, index: usize, row: &Row, cost: Cost, found: &mut [(f64, usize)]) {
        let Node { from, to, second, .. } = self.nodes[index];
        let last = found.len() - 1;
        if let Some(second) = second {
            let bounds = [index + 1, second].map(|child| (self.bound(child, row, cost), child));
            let [first, second] = if bounds[1].0 < bounds[0].0 { [bounds[1], bounds[0]] } else { bounds };
            for (bound, child) in [first, second] {
                if bound < found[last].0 {
                    self.search(child, row, cost, found);
                }
            }
            return;
        }
        self.compared += (to - from) as u64;
        for position in from..to {
            let value = cost.of(self.way(row, position)) + self.prices[position];
            if value < found[last].0 {
                let mut place = last;
                while place > 0 && found[place - 1].0 > value {
                    found[place] = found[place - 1];
                    place -= 1;
                }
                found[place] = (value, position);
            }
        }
    }

    /// Returns a lower bound on the cost of a node's columns for a row.
    fn bound(&self, index: usize, row: &Row, cost: Cost) -> f64 {
        let node = &self.nodes[index];
        let way = match (row.at, node.extent) {
            (None, _) | (_, Extent::Both) => 0.0,
            (Some(_), Extent::LeftOver) => row.left_over,
            (Some(at), Extent::Box([least, most])) => {
                let gap = |axis: usize| (least[axis] - at[axis]).max(at[axis] - most[axis]).max(0.0);
                (gap(0).powi(2) + gap(1).powi(2) + gap(2).powi(2)).sqrt()
            }
        };
        cost.of(way) + node.price
    }
}
