//! Approximate elimination: what preconditions where k jumps from face to face at random.
//!
//! There cells hang together by trees of strong faces that no coarse grid follows. The matrix is the
//! Laplacian of a graph: cells are vertices, faces edges of weight k/h². To eliminate a vertex with
//! neighbours i of weights w_i is to join all pairs of them by edges w_i w_j / Σ w, and a few rounds
//! of that fill the matrix. Here each neighbour, the most weakly joined first, is joined to one of those
//! that come after it, drawn in proportion to their weights and by an edge that makes up for those
//! left out, so that the edges' expectation is the exact one: a vertex of n neighbours leaves n - 1
//! edges, a tree, and the graph never fills. The factors L D Lᵀ are symmetric, positive but for the constant,
//! and good whatever the weights are (Kyng & Sachdeva 2016, arXiv:1605.02353; Chen, Liang & Biros 2021,
//! arXiv:2011.07769; Gao, Kyng & Spielman 2023, arXiv:2303.00709, of whom the order, vertices of few edges
//! first, and the parts of edges are).
//!
//! Serial, and the draws are the same every time.

use super::Fast;
use crate::field::{Faces, Field};
use crate::real::Real;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// More cells than this are not eliminated: edges are counted in 32 bits, and there are up to ten a cell.
const MOST_CELLS: usize = 1 << 28;

/// No vertex, no edge.
const NONE: u32 = u32::MAX;

/// Edges that a face is at first: more vary less, and take longer to eliminate. In two dimensions two
/// save a quarter of the iterations, in three one does.
const fn parts<const D: usize>() -> u32 {
    if D == 2 { 2 } else { 1 }
}

/// Vertices of this many edges and more wait in one queue.
const MANY: usize = 64;

/// The factors of a matrix, and the memory to solve with them.
#[derive(Debug)]
pub(super) struct Elimination {
    /// Of each cell, the first axis running fastest: its place in the order of elimination, which
    /// what follows is in.
    place: Vec<u32>,
    /// Where the links of each begin.
    begin: Vec<usize>,
    links: Vec<Link>,
    /// 1 / Σ w over the neighbours when it was eliminated.
    inverse_pivot: Vec<Fast>,
    scratch: Vec<Fast>,
}

/// An entry of L: a neighbour that is eliminated later, and its share w / Σ w.
#[derive(Clone, Copy, Debug)]
struct Link {
    to: u32,
    share: Fast,
}

impl Elimination {
    /// Factors of the matrix with these weights k/h² on faces; none of one of more than [`MOST_CELLS`].
    pub(super) fn new<const D: usize>(weights: &Faces<Fast, D>) -> Option<Self> {
        if weights[0].layout.cells.iter().product::<usize>() > MOST_CELLS {
            return None;
        }
        let mut graph = Graph::new(weights);
        let cells = graph.vertices.len();
        let mut waiting = Waiting::new(&mut graph.vertices);
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let mut found = Self {
            place: vec![NONE; cells],
            begin: Vec::with_capacity(cells + 1),
            links: Vec::with_capacity((D + 2) * cells),
            inverse_pivot: Vec::with_capacity(cells),
            scratch: vec![0.0; cells],
        };
        found.begin.push(0);
        let (mut neighbours, mut later) = (Vec::new(), Vec::new());
        while let Some(vertex) = waiting.next(&mut graph.vertices) {
            found.place[vertex as usize] = found.inverse_pivot.len() as u32;
            graph.take(vertex, &found.place, &mut neighbours);
            neighbours.sort_unstable_by(|a, b| a.weight.total_cmp(&b.weight).then(a.to.cmp(&b.to)));
            // Σ of the weights from each on.
            later.clear();
            later.extend(neighbours.iter().rev().scan(0.0, |sum, near| {
                *sum += f64::from(near.weight);
                Some(*sum)
            }));
            later.reverse();
            let pivot = later.first().copied().unwrap_or(0.0);
            for (n, near) in neighbours.iter().enumerate() {
                let share = f64::from(near.weight) / pivot;
                found.links.push(Link { to: near.to, share: share as Fast });
                let Some(&rest) = later.get(n + 1) else { break };
                let edges = near.edges.min(parts::<D>());
                let weight = (share * rest / f64::from(edges)) as Fast;
                for _ in 0..edges {
                    let drawn = draw(&neighbours[n + 1..], rest * random.random::<f64>());
                    graph.join(near.to, drawn, weight);
                }
            }
            found.begin.push(found.links.len());
            // The last of all, or of what hangs together, is held at zero.
            found.inverse_pivot.push(if pivot > 0.0 { (1.0 / pivot) as Fast } else { 0.0 });
        }
        for link in &mut found.links {
            link.to = found.place[link.to as usize];
        }
        Some(found)
    }

    /// The solution, up to a constant, for a right-hand side.
    pub(super) fn solve<R: Real, const D: usize>(
        &mut self,
        right: &Field<R, D>,
        solution: &mut Field<Fast, D>,
    ) {
        let Self { place, begin, links, inverse_pivot, scratch } = self;
        for (&place, right) in place.iter().zip(right.interior().flatten()) {
            scratch[place as usize] = right.f64() as Fast;
        }
        for (n, inverse) in inverse_pivot.iter().enumerate() {
            let own = scratch[n];
            for link in &links[begin[n]..begin[n + 1]] {
                scratch[link.to as usize] += link.share * own;
            }
            scratch[n] = own * inverse;
        }
        for n in (0..inverse_pivot.len()).rev() {
            let links = &links[begin[n]..begin[n + 1]];
            scratch[n] += links.iter().map(|l| l.share * scratch[l.to as usize]).sum::<Fast>();
        }
        let mut places = place.iter();
        solution.set(|_| places.next().map_or(0.0, |&place| scratch[place as usize]));
    }
}

/// The neighbour in whose stretch `target` lies, of stretches as long as the weights.
fn draw(neighbours: &[Near], mut target: f64) -> u32 {
    let mut drawn = NONE;
    for near in neighbours {
        drawn = near.to;
        target -= f64::from(near.weight);
        if target < 0.0 {
            break;
        }
    }
    drawn
}

/// A neighbour of the vertex that is being eliminated.
#[derive(Clone, Copy, Debug)]
struct Near {
    to: u32,
    weight: Fast,
    /// Edges that join it.
    edges: u32,
}

/// What is not yet eliminated.
#[derive(Debug)]
struct Graph {
    vertices: Vec<Vertex>,
    ends: Vec<End>,
    /// The first of the ends that are free, chained by `next`.
    free: u32,
}

#[derive(Clone, Copy, Debug)]
struct Vertex {
    /// Its first end of an edge.
    first: u32,
    /// The next in its queue.
    next: u32,
    /// Where it is among the neighbours of the vertex that is being eliminated.
    slot: u32,
    /// Edges to vertices not yet eliminated; several may join the same two.
    edges: u32,
}

/// One end of an edge, in the list of a vertex.
#[derive(Clone, Copy, Debug)]
struct End {
    to: u32,
    next: u32,
    weight: Fast,
}

impl Graph {
    fn new<const D: usize>(weights: &Faces<Fast, D>) -> Self {
        let cells = weights[0].layout.cells;
        let number = cells.iter().product();
        let vertex = Vertex { first: NONE, next: NONE, slot: NONE, edges: 0 };
        let parts = parts::<D>();
        let ends = Vec::with_capacity(2 * D * parts as usize * number);
        let mut graph = Self { vertices: vec![vertex; number], ends, free: NONE };
        let mut stride = 1;
        for axis in 0..D {
            for (cell, &weight) in weights[axis].interior().flatten().enumerate() {
                let below = match cell / stride % cells[axis] {
                    0 => cell + (cells[axis] - 1) * stride,
                    _ => cell - stride,
                };
                // Along an axis of one cell it is its own neighbour.
                if below != cell {
                    for _ in 0..parts {
                        graph.join(below as u32, cell as u32, weight / parts as Fast);
                    }
                }
            }
            stride *= cells[axis];
        }
        graph
    }

    /// Joins two vertices, unless the weight is too small for a number.
    fn join(&mut self, a: u32, b: u32, weight: Fast) {
        if weight <= 0.0 {
            return;
        }
        for (from, to) in [(a, b), (b, a)] {
            let vertex = &mut self.vertices[from as usize];
            let end = End { to, next: vertex.first, weight };
            vertex.edges += 1;
            if self.free == NONE {
                vertex.first = self.ends.len() as u32;
                self.ends.push(end);
            } else {
                vertex.first = self.free;
                let free = &mut self.ends[self.free as usize];
                self.free = free.next;
                *free = end;
            }
        }
    }

    /// Takes a vertex out: its neighbours that have no `place` yet, each once.
    fn take(&mut self, vertex: u32, place: &[u32], neighbours: &mut Vec<Near>) {
        neighbours.clear();
        let mut at = self.vertices[vertex as usize].first;
        while at != NONE {
            let End { to, next, weight } = self.ends[at as usize];
            self.ends[at as usize].next = self.free;
            self.free = at;
            at = next;
            if place[to as usize] != NONE {
                continue;
            }
            let slot = &mut self.vertices[to as usize].slot;
            if *slot == NONE {
                *slot = neighbours.len() as u32;
                neighbours.push(Near { to, weight, edges: 1 });
            } else {
                let near = &mut neighbours[*slot as usize];
                near.weight += weight;
                near.edges += 1;
            }
        }
        for near in neighbours {
            let vertex = &mut self.vertices[near.to as usize];
            vertex.slot = NONE;
            vertex.edges -= near.edges;
        }
    }
}

/// Vertices that wait, in a queue for each number of edges that they had when they were put there.
struct Waiting {
    /// First and last of each queue.
    queues: [[u32; 2]; MANY],
    /// No queue before this one has any.
    fewest: usize,
}

impl Waiting {
    fn new(vertices: &mut [Vertex]) -> Self {
        let mut waiting = Self { queues: [[NONE; 2]; MANY], fewest: 0 };
        for vertex in 0..vertices.len() as u32 {
            waiting.push(vertices, vertex);
        }
        waiting
    }

    fn push(&mut self, vertices: &mut [Vertex], vertex: u32) {
        let [first, last] = &mut self.queues[queue(vertices[vertex as usize])];
        vertices[vertex as usize].next = NONE;
        if *first == NONE {
            *first = vertex;
        } else {
            vertices[*last as usize].next = vertex;
        }
        *last = vertex;
    }

    /// The one of fewest edges. One that has more by now is put back first; one that has fewer has its
    /// turn a little late.
    fn next(&mut self, vertices: &mut [Vertex]) -> Option<u32> {
        while self.fewest < MANY {
            let first = self.queues[self.fewest][0];
            if first == NONE {
                self.fewest += 1;
                continue;
            }
            let vertex = vertices[first as usize];
            self.queues[self.fewest][0] = vertex.next;
            if queue(vertex) <= self.fewest {
                return Some(first);
            }
            self.push(vertices, first);
        }
        None
    }
}

fn queue(vertex: Vertex) -> usize {
    (vertex.edges as usize).min(MANY - 1)
}

#[cfg(test)]
mod tests {
    use super::super::{Stencil, image_row};
    use super::*;
    use crate::field::Layout;
    use crate::rows::Rows;

    /// Weights that jump from face to face by up to a contrast, and two noises without a mean.
    fn noise<const D: usize>(
        cells: [usize; D],
        contrast: Fast,
    ) -> (Faces<Fast, D>, [Field<Fast, D>; 2]) {
        let layout = Layout::new(cells);
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut weights = Field::zero_faces(layout);
        for weights in &mut weights {
            weights.set(|_| contrast.powf(random.random::<f32>()));
        }
        let rights = std::array::from_fn(|_| {
            let mut right = Field::zeros(layout);
            right.set(|_| random.random::<Fast>() - 0.5);
            let (mean, with_mean) = (right.mean() as Fast, right.clone());
            let mut values = with_mean.interior().flatten();
            right.set(|_| values.next().unwrap() - mean);
            right
        });
        (weights, rights)
    }

    fn exact<const D: usize>(cells: [usize; D]) {
        let (weights, [right, _]) = noise(cells, 100.0);
        let mut solution = Field::zeros(right.layout);
        Elimination::new(&weights).unwrap().solve(&right, &mut solution);
        let mut image = Field::zeros(right.layout);
        Rows::new(right.layout, false).each([&mut image], |o, [image]| {
            image_row(image, Stencil::at(&weights, &solution, o));
        });
        for (image, right) in image.interior().flatten().zip(right.interior().flatten()) {
            assert!((image - right).abs() < 1e-4, "{cells:?}: {image} {right}");
        }
    }

    #[test]
    fn a_ring_is_solved_exactly_because_a_vertex_of_two_neighbours_leaves_one_edge() {
        exact([2, 1]);
        exact([64, 1]);
        exact([1, 1, 30]);
        exact([2, 2]);
    }

    #[test]
    fn what_it_applies_is_symmetric_and_positive() {
        let (weights, rights) = noise([12, 10, 8], 1e6);
        let mut elimination = Elimination::new(&weights).unwrap();
        let solutions = rights.each_ref().map(|right| {
            let mut solution = Field::zeros(right.layout);
            elimination.solve(right, &mut solution);
            solution
        });
        let product = |i: usize, j: usize| -> f64 {
            let pairs = rights[i].interior().flatten().zip(solutions[j].interior().flatten());
            pairs.map(|(&x, &y)| f64::from(x) * f64::from(y)).sum()
        };
        let size = product(0, 0).min(product(1, 1));
        assert!(size > 0.0);
        assert!((product(0, 1) - product(1, 0)).abs() < 1e-4 * size);
    }

    #[test]
    fn neighbours_are_drawn_in_proportion_to_their_weights() {
        let near = |to, weight| Near { to, weight, edges: 1 };
        let neighbours = [near(4, 1.0), near(7, 2.0), near(9, 5.0)];
        let drawn = |target| draw(&neighbours, target);
        assert_eq!([0.0, 0.9].map(drawn), [4, 4]);
        assert_eq!([1.0, 2.9].map(drawn), [7, 7]);
        // Beyond the end only by rounding.
        assert_eq!([3.0, 7.9, 8.0].map(drawn), [9, 9, 9]);
    }

    #[test]
    fn cells_that_nothing_joins_stay_at_zero() {
        let layout = Layout::new([4, 6]);
        let mut right = Field::<f64, 2>::zeros(layout);
        right.set(|[i, j]| if (i + j) % 2 == 0 { 1.0 } else { -1.0 });
        let mut solution = Field::zeros(layout);
        Elimination::new(&Field::zero_faces(layout)).unwrap().solve(&right, &mut solution);
        assert_eq!([solution.min(), solution.max()], [0.0, 0.0]);
    }
}
