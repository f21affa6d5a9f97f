//! Lists of pairs of cones that may come within reach of each other.
//!
//! The wide list is made from bins, once a growth cycle as a rule; the short one, of pairs that may touch, is taken from it whenever a cone has
//! moved 0.3 radii. Between the first and the second shell of neighbours there is a gap, so the short list holds little more than the pairs in touch.

use glam::DVec2;

use super::super::local::Metric;
use super::cone::length2;
use super::sectors::Sectors;

/// Largest D on the wide list.
const WIDE: f64 = 2.0;
/// Largest D on the short list.
const SHORT: f64 = 1.3;
/// What the inner loop reads of a cone, together in memory.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    pub(super) at: DVec2,
    pub(super) metric: Metric,
    pub(super) radius: f64,
    /// No cone near by has a larger radius, µm.
    pub(super) largest: f64,
    pub(super) moves: bool,
}

/// Squared distance of two bodies across their mean direction.
#[inline]
pub(super) fn distance2(p: &Body, n: &Body) -> f64 {
    length2((&p.metric, p.at), (&n.metric, n.at))
}

/// Whether the two have D below `limit`.
#[inline]
pub(super) fn are_within(p: &Body, n: &Body, limit: f64) -> bool {
    let reach = limit * (p.radius + n.radius);
    distance2(p, n) < reach * reach
}

/// Pairs (i, j > i) in order of i.
#[derive(Debug, Default)]
pub(super) struct Pairs {
    start: Vec<u32>,
    other: Vec<u32>,
    /// Places when the list was made.
    at: Vec<DVec2>,
}

impl Pairs {
    /// All pairs with D < `limit`.
    pub(super) fn within(bodies: &[Body], sectors: &Sectors, limit: f64) -> Self {
        let mut pairs = Self { start: vec![0], other: Vec::with_capacity(10 * bodies.len()), at: Vec::new() };
        for (i, body) in bodies.iter().enumerate() {
            let reach = limit * (body.radius + body.largest) / body.metric.shortest();
            sectors.near(body.at, reach, |items| {
                let mut end = pairs.other.len();
                pairs.other.resize(end + items.len(), 0);
                for &j in items {
                    pairs.other[end] = j;
                    let wanted = (j as usize > i) && are_within(body, &bodies[j as usize], limit);
                    end += usize::from(wanted);
                }
                pairs.other.truncate(end);
            });
            pairs.start.push(pairs.other.len() as u32);
        }
        pairs.at.extend(bodies.iter().map(|b| b.at));
        pairs
    }

    /// The wide list.
    pub(super) fn wide(bodies: &[Body]) -> Self {
        let at: Vec<DVec2> = bodies.iter().map(|b| b.at).collect();
        Self::within(bodies, &Sectors::new(&at, mean_spacing(bodies)), WIDE)
    }

    /// Fills `short` with the pairs that may touch before the next look, at least one of which moves.
    pub(super) fn shorten(&self, bodies: &[Body], short: &mut Self) {
        short.start.clear();
        short.start.push(0);
        short.other.clear();
        short.other.reserve(self.other.len());
        for (i, body) in bodies.iter().enumerate() {
            for &j in self.of(i) {
                let other = &bodies[j as usize];
                if (body.moves | other.moves) && are_within(body, other, SHORT) {
                    short.other.push(j);
                }
            }
            short.start.push(short.other.len() as u32);
        }
        short.at.clear();
        short.at.extend(bodies.iter().map(|b| b.at));
    }

    /// Partners j > i of cone i.
    #[inline]
    pub(super) fn of(&self, i: usize) -> &[u32] {
        &self.other[self.start[i] as usize..self.start[i + 1] as usize]
    }

    /// Whether the short list may miss a pair in touch.
    pub(super) fn short_is_stale(&self, bodies: &[Body]) -> bool {
        self.are_stale(bodies, SHORT - 1.0)
    }

    /// Whether the wide list may miss a pair with D < `limit`.
    pub(super) fn wide_is_stale(&self, bodies: &[Body], limit: f64) -> bool {
        self.are_stale(bodies, WIDE - limit)
    }

    /// As the short list needs it.
    pub(super) fn wide_is_stale_for_short(&self, bodies: &[Body]) -> bool {
        self.wide_is_stale(bodies, SHORT)
    }

    /// Whether some cone has moved more than `skin` radii since the list was made.
    fn are_stale(&self, bodies: &[Body], skin: f64) -> bool {
        self.at.len() != bodies.len()
            || bodies.iter().zip(&self.at).any(|(b, &at)| {
                let limit = 0.98 * skin * b.radius;
                b.moves && b.metric.length2(b.at - at) > limit * limit
            })
    }

    /// Both directions of the pairs with D <= `limit`: first entry of each cone and the partners.
    pub(super) fn both_ways(&self, bodies: &[Body], limit: f64) -> Links {
        let mut links = Links { start: vec![0; bodies.len() + 1], other: Vec::new() };
        let mut kept: Vec<(u32, u32)> = Vec::with_capacity(4 * bodies.len());
        for (i, body) in bodies.iter().enumerate() {
            for &j in self.of(i) {
                if are_within(body, &bodies[j as usize], limit) {
                    kept.push((i as u32, j));
                    links.start[i + 1] += 1;
                    links.start[j as usize + 1] += 1;
                }
            }
        }
        for i in 0..bodies.len() {
            links.start[i + 1] += links.start[i];
        }
        let mut next = links.start.clone();
        links.other = vec![0; 2 * kept.len()];
        for (i, j) in kept {
            for (from, to) in [(i, j), (j, i)] {
                let slot = &mut next[from as usize];
                links.other[*slot as usize] = to;
                *slot += 1;
            }
        }
        links
    }
}

/// Mean distance of neighbours, µm of the chart.
pub(super) fn mean_spacing(bodies: &[Body]) -> f64 {
    bodies.iter().map(|b| 2.0 * b.radius / b.metric.shortest()).sum::<f64>() / bodies.len().max(1) as f64
}

/// The partners of every cone.
#[derive(Debug)]
pub(super) struct Links {
    start: Vec<u32>,
    other: Vec<u32>,
}

impl Links {
    /// Partners of cone `i`.
    pub(super) fn of(&self, i: usize) -> &[u32] {
        &self.other[self.start[i] as usize..self.start[i + 1] as usize]
    }

    /// Hops from the nearest of the `seeds`, up to `limit`; `FAR` beyond. Also the cones reached, seeds first.
    pub(super) fn hops(&self, seeds: impl Iterator<Item = u32>, limit: u8, hops: &mut [u8]) -> Vec<u32> {
        let mut reached: Vec<u32> = seeds.collect();
        for &i in &reached {
            hops[i as usize] = 0;
        }
        let mut next = 0;
        while next < reached.len() {
            let i = reached[next] as usize;
            next += 1;
            if hops[i] == limit {
                break;
            }
            for &j in self.of(i) {
                if hops[j as usize] == FAR {
                    hops[j as usize] = hops[i] + 1;
                    reached.push(j);
                }
            }
        }
        reached
    }
}

/// More hops than were followed.
pub(super) const FAR: u8 = u8::MAX;
