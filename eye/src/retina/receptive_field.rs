//! Receptive fields of cones (§15.4, last paragraph).
//!
//! Small: one cone is the centre, its immediate neighbours are the surround (0 centre generations, 1 surround generation). Larger: a cone with one
//! or more generations of neighbours is the centre, two or more generations outside are the surround. With 1, 2, 3, 4 generations a cone and
//! those round it are 7, 19, 37, 62 cones on the mean (here 6.89, 18.96, 37.4, 62.3 in the fovea, 6.83, 18.93, 37.5, 62.9 farther out).
//!
//! Signal: mean count of the centre less `surround_weight` times the mean count of the surround. With weight 1 an even field gives no signal;
//! with less, some of the mean level passes. The paper sets the strengths by algorithms of its own that it does not describe.
//!
//! # Cost
//! Measured: 3.5 µs for the 37 cones of three generations.

use super::graph::NeighbourGraph;

/// What a cone does in a receptive field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Role {
    /// It is in the centre.
    Centre = 0,
    /// It is in the antagonistic surround.
    Surround = 1,
}

/// One cone of a receptive field, for tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldRow {
    /// The cone in the middle of the field, its index in the retina.
    pub field: u32,
    /// The cone.
    pub cone: u32,
    /// Hops from the one to the other.
    pub generation: u32,
    /// Centre or surround.
    pub role: Role,
}

/// A centre and its surround: indices of cones in the retina, generation by generation, each ascending.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceptiveField {
    /// The cones of the centre, the middle one first.
    pub centre: Vec<u32>,
    /// The cones of the surround.
    pub surround: Vec<u32>,
    /// Whether no edge cone lies in it but in its last generation: nothing of it is cut off.
    pub is_whole: bool,
    /// Cones up to the end of each generation.
    ends: Vec<u32>,
}

impl ReceptiveField {
    /// The field about a cone: `centre_generations` (0: the cone alone) and then `surround_generations` of neighbours. Smaller where the
    /// retina ends; empty when there is no such cone.
    pub fn new(
        graph: &NeighbourGraph,
        cone: u32,
        centre_generations: usize,
        surround_generations: usize,
    ) -> Self {
        let last = centre_generations.saturating_add(surround_generations);
        let generations = graph.generations(cone, last);
        let mut field =
            Self { centre: vec![], surround: vec![], is_whole: !generations.is_empty(), ends: vec![] };
        let mut end = 0;
        for (generation, cones) in generations.iter().enumerate() {
            let part = if generation <= centre_generations { &mut field.centre } else { &mut field.surround };
            part.extend(cones);
            field.is_whole &= generation == last || !cones.iter().any(|&c| graph.is_edge(c));
            end += cones.len() as u32;
            field.ends.push(end);
        }
        field
    }

    /// The field as rows of a table.
    pub fn rows(&self) -> impl Iterator<Item = FieldRow> + '_ {
        let field = self.centre.first().copied().unwrap_or(0);
        let centre = self.centre.len();
        self.centre.iter().chain(&self.surround).enumerate().map(move |(k, &cone)| FieldRow {
            field,
            cone,
            generation: self.ends.partition_point(|&end| end as usize <= k) as u32,
            role: if k < centre { Role::Centre } else { Role::Surround },
        })
    }

    /// Mean of the centre's counts less `surround_weight` times the mean of the surround's; counts by cone of the retina. `None` when
    /// centre or surround is empty or a count is missing.
    pub fn response(&self, counts: &[f64], surround_weight: f64) -> Option<f64> {
        Some(mean(&self.centre, counts)? - surround_weight * mean(&self.surround, counts)?)
    }
}

fn mean(cones: &[u32], counts: &[f64]) -> Option<f64> {
    let mut sum = 0.0;
    for &cone in cones {
        sum += counts.get(cone as usize)?;
    }
    (!cones.is_empty()).then(|| sum / cones.len() as f64)
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::super::graph::tests::{hexagons, nearest, patch};
    use super::*;

    /// §15.4: 7, 19, 37 and 62 cones in 1 to 4 generations. Means over all fields that are not cut off.
    #[test]
    fn sizes_of_generations() {
        for (at, half, tolerance) in [
            // A corner of four or five cones takes two neighbours away: 2 % of the first generation.
            (DVec2::ZERO, 80.0, [0.03, 0.02, 0.02, 0.02]),
            (DVec2::new(600.0, 0.0), 200.0, [0.03; 4]),
            (DVec2::new(-9_000.0, 9_000.0), 600.0, [0.03; 4]),
        ] {
            let retina = patch(at, half);
            let graph = NeighbourGraph::new(&retina);
            let (mut sums, mut fields) = ([0.0; 4], 0.0);
            for cone in 0..graph.len() as u32 {
                let field = ReceptiveField::new(&graph, cone, 2, 2);
                if field.is_whole {
                    fields += 1.0;
                    for (sum, end) in sums.iter_mut().zip(&field.ends[1..]) {
                        *sum += f64::from(*end);
                    }
                }
            }
            let means = sums.map(|s| s / fields);
            assert!(fields > 100.0);
            for ((mean, want), tolerance) in means.iter().zip([7.0, 19.0, 37.0, 62.0]).zip(tolerance) {
                assert!((mean / want - 1.0).abs() < tolerance, "{at} {means:?}");
            }
        }
    }

    #[test]
    fn centre_surround_and_table() {
        let retina = hexagons(4);
        let graph = NeighbourGraph::new(&retina);
        let middle = nearest(&retina, DVec2::ZERO);
        let small = ReceptiveField::new(&graph, middle, 0, 1);
        assert_eq!(
            (small.centre.as_slice(), small.surround.as_slice()),
            (&[middle][..], graph.neighbours(middle))
        );
        let large = ReceptiveField::new(&graph, middle, 1, 2);
        assert_eq!((large.centre.len(), large.surround.len()), (7, 30));
        assert!(large.is_whole && !ReceptiveField::new(&graph, middle, 3, 2).is_whole);
        let rows: Vec<FieldRow> = large.rows().collect();
        let generations = graph.generations(middle, 3);
        assert_eq!(rows.len(), 37);
        for row in rows {
            assert!(generations[row.generation as usize].contains(&row.cone));
            assert_eq!((row.field, row.role == Role::Centre), (middle, row.generation <= 1));
        }
    }

    #[test]
    fn response_is_the_difference_of_means() {
        let retina = hexagons(2);
        let graph = NeighbourGraph::new(&retina);
        let middle = nearest(&retina, DVec2::ZERO);
        let field = ReceptiveField::new(&graph, middle, 0, 1);
        let even = vec![40.0; 19];
        assert_eq!(field.response(&even, 1.0), Some(0.0));
        assert_eq!(field.response(&even, 0.75), Some(10.0));
        let mut spot = even.clone();
        spot[middle as usize] += 12.0;
        assert_eq!(field.response(&spot, 1.0), Some(12.0));
        assert_eq!(field.response(&spot[..3], 1.0), None);
        // A lone cone has no surround, a missing one nothing at all.
        let one = NeighbourGraph::new(&hexagons(0));
        assert_eq!(ReceptiveField::new(&one, 0, 0, 1).response(&even, 1.0), None);
        let none = ReceptiveField::new(&one, 5, 1, 2);
        assert!(none.centre.is_empty() && !none.is_whole && none.rows().next().is_none());
    }
}
