//! Eye movement during viewing (§11): where the line of sight meets the screen at a time.
//!
//! The line of sight starts on the fixated point; a movement is a path (x, y) of visual angle from there:
//! drift, random walk or a recording, with tremor and microsaccades on top. The eye turns about its rotation
//! centre; seen from straight ahead every turn is about an axis in Listing's plane. The screen stays where it
//! is: [`Gaze::screen_tangent`] is how far the place moves over it that one place of the retina sees, the
//! fovea or another ([`Gaze::seen_along`]). [`Gaze::path`] gives a stretch of time as straight lines on the
//! screen, to 1e-6 rad (0.003 arcmin); the default drift is one line a frame.
//!
//! # Stability
//! The usual slerp through acos is NaN or 0/0 below 1e-8 rad; here the angle is known, so no arc cosine is taken.

mod fixation;
pub mod recording;
mod validate;
mod walk;

use std::sync::Arc;

use glam::{DQuat, DVec2, DVec3};

use crate::display::EmissionLaw;
use crate::experiment::{self, Movement, RangeError};
use crate::optics::Fixation;
use crate::optics::fixation::listing;
use fixation::{Saccade, Tremor};
use walk::Walk;

/// Largest turn that is served, degrees.
const MAX_TURN_DEG: f64 = 45.0;
/// How far a straight line may be from the path, unit tangents.
const STRAIGHT: f64 = 1e-6;
/// Most times that a stretch of path is halved.
const MAX_HALVINGS: u32 = 10;
/// Most pieces that a movement may have by itself in a frame.
const MAX_PIECES: f64 = 4096.0;

/// Radians of an arcminute.
pub(crate) fn radians(arcmin: f64) -> f64 {
    (arcmin / 60.0).to_radians()
}

/// Movement in front of a screen.
#[derive(Clone, Debug)]
pub struct Gaze {
    base: Arc<Base>,
    tremor: Option<Tremor>,
    saccades: Arc<[Saccade]>,
    /// Eye and screen at rest.
    fixation: Fixation,
    /// A point of the screen and the direction from the eye in which it is seen at rest, over the screen's nominal
    /// distance, in the view frame; where the line meets the screen.
    line: [DVec3; 2],
    rest: DVec2,
    /// Rectangle of the turns over all frames, radians.
    turns: [DVec2; 2],
}

/// Parts of each side of the rectangle of turns at which the place on the screen is looked at.
const BOUNDS: u32 = 8;
/// Where a line of sight is that misses the screen, unit tangents: no scene is that large.
const MISSED: DVec2 = DVec2::splat(1e3);

/// The path without tremor and microsaccades.
#[derive(Clone, Debug)]
enum Base {
    Drift {
        radians_per_s: f64,
        /// Unit direction in the visual field, x right, y up.
        direction: DVec2,
    },
    Walk(Walk),
    /// Times, s, and places, radians.
    Recorded(Vec<(f64, DVec2)>),
}

impl Base {
    fn new(movement: &Movement, seed: u64, duration_s: f64) -> Self {
        match movement {
            Movement::Still => Self::Drift { radians_per_s: 0.0, direction: DVec2::X },
            Movement::Drift { speed_arcmin_per_s, direction_deg } => Self::Drift {
                radians_per_s: radians(*speed_arcmin_per_s),
                direction: DVec2::from_angle(direction_deg.to_radians()),
            },
            Movement::Walk { unit_arcmin } => Self::Walk(Walk::new(seed, radians(*unit_arcmin), duration_s)),
            Movement::Recorded(samples) => Self::Recorded(
                samples.iter().map(|[t, x, y]| (*t, DVec2::new(radians(*x), radians(*y)))).collect(),
            ),
            // Refused before, see `validate`.
            Movement::Recording(_) => Self::Recorded(Vec::new()),
        }
    }

    /// Visual angle from the fixated point at a time, radians.
    fn at(&self, t_s: f64) -> DVec2 {
        match self {
            Self::Drift { radians_per_s, direction } => *radians_per_s * t_s * *direction,
            Self::Walk(walk) => walk.at(t_s),
            Self::Recorded(samples) => {
                let next = samples.partition_point(|s| s.0 <= t_s);
                match (next.checked_sub(1).map(|i| samples[i]), samples.get(next)) {
                    (Some((t0, from)), Some((t1, to))) => from.lerp(*to, (t_s - t0) / (t1 - t0)),
                    (Some((_, last)), None) => last,
                    (None, first) => first.map_or(DVec2::ZERO, |f| f.1),
                }
            }
        }
    }

    /// Times between two times (exclusive) at which the path bends.
    fn bends(&self, from: f64, to: f64) -> Vec<f64> {
        match self {
            Self::Drift { .. } => Vec::new(),
            Self::Walk(_) => Walk::bends(from, to),
            Self::Recorded(samples) => {
                let first = samples.partition_point(|sample| sample.0 <= from);
                samples[first..].iter().map(|sample| sample.0).take_while(|t| *t < to).collect()
            }
        }
    }
}

impl Gaze {
    /// The movement of an eye that fixates a point of a screen at rest, over frames of a length (s); as its
    /// fovea sees it.
    ///
    /// # Errors
    /// When the eye would turn by more than 45°, or a frame would hold more movement than is served.
    pub fn new(
        gaze: &experiment::Gaze,
        fixation: &Fixation,
        frames: u32,
        frame_s: f64,
    ) -> Result<Self, RangeError> {
        let duration_s = f64::from(frames) * frame_s;
        check_pieces(gaze, frame_s, duration_s)?;
        let base = Base::new(&gaze.movement, gaze.seed, duration_s);
        let tremor = gaze.tremor.map(|t| Tremor::new(&t, gaze.seed));
        let saccades = gaze.microsaccades.map_or_else(Vec::new, |spec| {
            fixation::saccades(&spec, gaze.seed, duration_s, |t_s| base.at(t_s))
        });
        let fovea = [fixation.screen.way(DVec2::ZERO), DVec3::NEG_Z];
        let (rest, turns) = (DVec2::ZERO, [DVec2::ZERO; 2]);
        let (base, saccades) = (Arc::new(base), saccades.into());
        let mut made = Self { base, tremor, saccades, fixation: *fixation, line: fovea, rest, turns };
        made.check_turn(gaze, duration_s)?;
        let turned = made.turns_between(0.0, duration_s);
        made.turns = turned.into_iter().fold(turns, |[min, max], turn| [min.min(turn), max.max(turn)]);
        Ok(made)
    }

    /// The same as a place of the retina sees it to which a line of object space leads, see
    /// [`crate::optics::Projection::line_to`].
    #[must_use]
    pub fn seen_along(&self, line: [DVec3; 2]) -> Self {
        let rest = self.fixation.screen.met_by(line[0] - line[1], line[1]).unwrap_or(MISSED);
        Self { line, rest, ..self.clone() }
    }

    /// The turns at all bends of the path between two times.
    fn turns_between(&self, from_s: f64, to_s: f64) -> Vec<DVec2> {
        let mut times = vec![from_s];
        times.extend(self.bends(from_s, to_s));
        times.into_iter().map(|t_s| self.turn(t_s)).collect()
    }

    /// Times after one time, up to another, at which the path bends.
    fn bends(&self, from_s: f64, to_s: f64) -> Vec<f64> {
        let mut times = self.base.bends(from_s, to_s);
        let jumps = self.saccades.iter().flat_map(|s| [s.start_s, s.end_s]);
        times.extend(jumps.filter(|t| *t > from_s && *t < to_s));
        if let Some(tremor) = &self.tremor {
            times.extend(tremor.bends(from_s, to_s));
        }
        times.push(to_s);
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    fn check_turn(&self, gaze: &experiment::Gaze, duration_s: f64) -> Result<(), RangeError> {
        let mut times = self.base.bends(0.0, duration_s);
        times.extend(self.saccades.iter().map(|s| s.end_s));
        times.extend([0.0, duration_s]);
        let turn = times.iter().map(|t| self.turn(*t).length()).fold(0.0, f64::max).to_degrees();
        if turn <= MAX_TURN_DEG {
            return Ok(());
        }
        let allowed = format!("at most {MAX_TURN_DEG}° over all frames ({duration_s} s), here it is {turn}°");
        let (field, value) = match &gaze.movement {
            Movement::Drift { speed_arcmin_per_s, .. } => ("drift.speed_arcmin_per_s", *speed_arcmin_per_s),
            Movement::Walk { unit_arcmin } => ("walk.unit_arcmin", *unit_arcmin),
            Movement::Recorded(_) | Movement::Recording(_) => ("recorded", turn),
            Movement::Still => ("microsaccades", turn),
        };
        Err(RangeError::new(&format!("gaze.movement.{field}"), value, &allowed))
    }

    /// Visual angle from the fixated point at a time, radians: the axis of the turn is at right angles to it.
    pub fn turn(&self, t_s: f64) -> DVec2 {
        let mut at = self.base.at(t_s);
        if let Some(tremor) = &self.tremor {
            at += tremor.at(t_s);
        }
        if !self.saccades.is_empty() {
            at += fixation::jumped(&self.saccades, t_s);
        }
        at
    }

    /// Orientation of the eye relative to rest at time `t_s`; axes x right, y up, z towards the viewer.
    pub fn orientation(&self, t_s: f64) -> DQuat {
        self.orientation_at(self.turn(t_s))
    }

    /// The same for a turn of the line of sight, radians.
    fn orientation_at(&self, turn: DVec2) -> DQuat {
        // The eye looks along -z; a turn about (y, -x) carries -z towards (x, y).
        let direction = turn.normalize_or(DVec2::X);
        let turned = DQuat::from_axis_angle(DVec3::new(direction.y, -direction.x, 0.0), turn.length());
        let head = self.fixation.turn;
        if head == DQuat::IDENTITY {
            return turned;
        }
        // Listing's law holds for the turn from straight ahead.
        head.inverse() * listing(head * (turned * DVec3::NEG_Z))
    }

    /// How far the place on the screen has moved that is seen, in units of the screen, x right, y up.
    pub fn screen_tangent(&self, t_s: f64) -> DVec2 {
        self.moved_by(self.turn(t_s))
    }

    /// The same for a turn of the line of sight, radians.
    pub fn moved_by(&self, turn: DVec2) -> DVec2 {
        if turn == DVec2::ZERO {
            return DVec2::ZERO;
        }
        let [from, along] = self.turned_line(turn);
        self.fixation.screen.met_by(from, along).map_or(MISSED, |place| place - self.rest)
    }

    /// The line along which the place is seen when the eye has turned about its rotation centre: where it begins and
    /// its direction.
    fn turned_line(&self, turn: DVec2) -> [DVec3; 2] {
        let turned = self.orientation_at(turn);
        let [point, along] = self.line;
        [self.turned_place(&turned, point - along), turned * along]
    }

    /// Where a point of the eye is after a turn, over the screen's nominal distance.
    fn turned_place(&self, turned: &DQuat, place: DVec3) -> DVec3 {
        let centre = self.fixation.rotation_centre_mm / self.fixation.screen.nominal_mm();
        centre + *turned * (place - centre)
    }

    /// Irradiance at the corneal apex from the place on the screen that is seen after a turn (radians), over
    /// that at rest.
    pub fn light(&self, law: EmissionLaw, turn: DVec2) -> f64 {
        let screen = &self.fixation.screen;
        let apex = self.turned_place(&self.orientation_at(turn), DVec3::ZERO);
        let seen = self.rest + self.moved_by(turn);
        law.irradiance_at(apex, screen, seen) / law.irradiance_at(DVec3::ZERO, screen, self.rest)
    }

    /// The line of sight on the screen from one time to another as straight lines: times (s) and places (unit tangents).
    pub fn path(&self, from_s: f64, to_s: f64) -> Vec<(f64, DVec2)> {
        let times = self.bends(from_s, to_s);
        let mut path = vec![(from_s, self.screen_tangent(from_s))];
        for t_s in times {
            self.straighten((t_s, self.screen_tangent(t_s)), MAX_HALVINGS, &mut path);
        }
        path
    }

    /// Adds a point, and points before it until the path between is straight.
    fn straighten(&self, to: (f64, DVec2), halvings: u32, path: &mut Vec<(f64, DVec2)>) {
        if let Some(&from) = path.last()
            && halvings > 0
        {
            let middle_s = 0.5 * (from.0 + to.0);
            let middle = self.screen_tangent(middle_s);
            if (middle - 0.5 * (from.1 + to.1)).length() > STRAIGHT {
                self.straighten((middle_s, middle), halvings - 1, path);
                self.straighten(to, halvings - 1, path);
                return;
            }
        }
        path.push(to);
    }

    /// The rectangle of the movement on the screen over all frames, in units of the screen.
    pub fn bounds(&self) -> [DVec2; 2] {
        self.rectangle().into_iter().fold([DVec2::ZERO; 2], |[min, max], turn| {
            let moved = self.moved_by(turn);
            [min.min(moved), max.max(moved)]
        })
    }

    /// Turns over the rectangle of all turns, radians.
    pub fn rectangle(&self) -> Vec<DVec2> {
        let ([min, max], part) = (self.turns, |i: u32| f64::from(i) / f64::from(BOUNDS));
        let places = (0..=BOUNDS).flat_map(|i| (0..=BOUNDS).map(move |j| DVec2::new(part(i), part(j))));
        places.map(|place| min + place * (max - min)).collect()
    }

    /// Largest difference of two movements on the screen over all turns, in units of the screen.
    pub fn largest_difference(&self, other: &Self) -> f64 {
        let difference = |turn: DVec2| (self.moved_by(turn) - other.moved_by(turn)).length();
        self.rectangle().into_iter().map(difference).fold(0.0, f64::max)
    }

    /// Whether the eye rests.
    pub fn is_still(&self) -> bool {
        let still = match &*self.base {
            Base::Drift { radians_per_s, .. } => *radians_per_s <= 0.0,
            _ => false,
        };
        still && self.tremor.is_none() && self.saccades.is_empty()
    }
}

/// A table of a recording whose samples nobody has read.
fn unread(table: &str) -> RangeError {
    RangeError::new("gaze.movement.recorded.blob", table, "a table whose samples were read")
}

/// Bounds the work that movement asks for in a frame and over all.
fn check_pieces(gaze: &experiment::Gaze, frame_s: f64, duration_s: f64) -> Result<(), RangeError> {
    if let Movement::Recording(table) = &gaze.movement {
        return Err(unread(table));
    }
    let field = "gaze.movement";
    let most = |what: &str, pieces: f64, of: f64| {
        let allowed = format!("at most {of} {what}");
        if pieces > of { Err(RangeError::new(field, pieces, &allowed)) } else { Ok(()) }
    };
    if matches!(gaze.movement, Movement::Walk { .. }) {
        most("steps of the random walk in a frame", frame_s / walk::STEP_S, MAX_PIECES)?;
        most("steps of the random walk over all frames", duration_s / walk::STEP_S, 1e7)?;
    }
    if let Some(tremor) = &gaze.tremor {
        most("periods of tremor in a frame", frame_s * tremor.to_hz, 500.0)?;
        most("periods of tremor over all frames", duration_s * tremor.to_hz, 1e6)?;
    }
    if let Some(saccades) = &gaze.microsaccades {
        most("microsaccades in a frame", frame_s * saccades.rate_hz, 100.0)?;
        most("microsaccades over all frames", duration_s * saccades.rate_hz, 1e5)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::{Microsaccades, Tremor as TremorSpec};
    use crate::optics::{Dispersion, EyeState, Prescription, SchematicEye, Side};

    /// Before a screen at a distance, cm.
    fn moving(
        gaze: &experiment::Gaze,
        distance_cm: f64,
        frames: u32,
        frame_s: f64,
    ) -> Result<Gaze, RangeError> {
        Gaze::new(gaze, &fixation(distance_cm), frames, frame_s)
    }

    fn fixation(distance_cm: f64) -> Fixation {
        Fixation::frontal(&eye(), 10.0 * distance_cm)
    }

    fn eye() -> SchematicEye {
        let state = EyeState {
            pupil_mm: 3.0,
            decentre_mm: 0.0,
            accommodation_a: 0.0,
            dispersion: Dispersion::Herzberger,
            side: Side::Right,
        };
        SchematicEye::new(&Prescription::preset("escudero-sanz-navarro").unwrap(), &state).unwrap()
    }

    fn gaze_of(movement: Movement) -> experiment::Gaze {
        experiment::Gaze { movement, ..experiment::Gaze::still([0.0; 2]) }
    }

    fn drift(speed_arcmin_per_s: f64, direction_deg: f64) -> experiment::Gaze {
        gaze_of(Movement::Drift { speed_arcmin_per_s, direction_deg })
    }

    #[test]
    fn the_default_drift_goes_right_and_up() {
        let gaze = moving(&drift(6.0, 30.0), 1e12, 1, 1.0).unwrap();
        let shift = gaze.screen_tangent(1.0);
        let angle = (0.1_f64).to_radians();
        assert!((shift - angle.tan() * DVec2::new(3_f64.sqrt() / 2.0, 0.5)).length() < 1e-12);
        // A frame: 1.7e-5 rad/s x 1/60 s keeps all its digits.
        let frame = gaze.screen_tangent(1.0 / 60.0).length();
        assert!((frame / (angle / 60.0) - 1.0).abs() < 1e-9);
        assert_eq!(gaze.path(0.0, 1.0 / 60.0).len(), 2, "one straight line");
    }

    /// Listing's law: the axis of every turn lies in the plane across the line of sight at rest, so torsion is none.
    #[test]
    fn turns_have_no_torsion() {
        let gaze = moving(&drift(1200.0, 40.0), 100.0, 60, 1.0 / 60.0).unwrap();
        for t_s in [1e-9, 0.1, 1.0] {
            assert!(gaze.orientation(t_s).z.abs() < 1e-15);
        }
    }

    #[test]
    fn still_is_still_and_too_far_is_refused() {
        let still = moving(&gaze_of(Movement::Still), 100.0, 100_000, 1.0).unwrap();
        assert_eq!(still.screen_tangent(77.0), DVec2::ZERO);
        assert!(still.is_still());
        assert!(moving(&drift(60000.0, 0.0), 100.0, 1, 1.0).is_err());
        let fast = moving(&drift(60000.0, 0.0), 100.0, 1, 0.04).unwrap();
        let path = fast.path(0.0, 0.04);
        assert!(path.len() > 10, "40° are not straight in time on a flat screen");
        // Rotation centre 13.5 mm behind the apex along the optical axis and 0.5 mm nasal; the line of sight
        // is 5° from the axis.
        let (sin, cos) = 5_f64.to_radians().sin_cos();
        let (behind, temporal) = (13.5 * cos - 0.5 * sin, -(0.5 * cos + 13.5 * sin));
        let (far, turn) = (1000.0 + behind, 40_f64.to_radians());
        let right = far * turn.tan() + temporal * (1.0 - 1.0 / turn.cos());
        let last = path[path.len() - 1].1;
        assert!((1000.0 * last.x - right).abs() < 1e-9, "{} {right}", 1000.0 * last.x);
    }

    #[test]
    fn a_recorded_path_is_followed_and_its_end_stays() {
        let samples = vec![[0.1, 0.0, 0.0], [0.2, 30.0, -60.0], [0.4, 30.0, 0.0]];
        let gaze = moving(&gaze_of(Movement::Recorded(samples)), 1e9, 1, 1.0).unwrap();
        let at = |t_s| gaze.screen_tangent(t_s) / radians(1.0);
        assert!(at(0.05).length() < 1e-9 && (at(9.0) - DVec2::new(30.0, 0.0)).length() < 1e-2);
        assert!((at(0.15) - DVec2::new(15.0, -30.0)).length() < 1e-2);
        assert!((at(0.3) - DVec2::new(30.0, -30.0)).length() < 1e-2);
        let times: Vec<f64> = gaze.path(0.0, 1.0).iter().map(|p| p.0).collect();
        assert!([0.1, 0.2, 0.4].iter().all(|t| times.contains(t)), "{times:?}");
    }

    /// The straight lines of a path stay within the tolerance of the true path, whatever moves.
    #[test]
    fn paths_are_straight_enough() {
        let mut gaze = gaze_of(Movement::Walk { unit_arcmin: 0.5 });
        gaze.tremor = Some(TremorSpec { rms_arcmin: 0.3, from_hz: 30.0, to_hz: 100.0 });
        gaze.microsaccades = Some(Microsaccades { rate_hz: 20.0, ..Microsaccades::default() });
        let gaze = moving(&gaze, 60.0, 60, 1.0 / 60.0).unwrap();
        let path = gaze.path(0.0, 0.5);
        for pair in path.windows(2) {
            for part in [0.2, 0.5, 0.9] {
                let t_s = pair[0].0 + part * (pair[1].0 - pair[0].0);
                let line = pair[0].1.lerp(pair[1].1, part);
                assert!((gaze.screen_tangent(t_s) - line).length() < 2.0 * STRAIGHT, "{t_s}");
            }
        }
        let [min, max] = gaze.bounds();
        assert!(path.iter().all(|p| p.1.cmpge(min).all() && p.1.cmple(max).all()));
    }
}
