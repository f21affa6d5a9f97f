//! Engine `paper`: §21–22 to the letter, photon by photon. The slow reference and the anchor of every comparison.
//!
//! Point spreads of 1024 randomly perturbed rays on 128 x 128 samples, a window of at least 20 µm, renormalized, every 10 nm of wavelength and
//! every 300 µm of retina, held as cumulative tables. Each photon that enters the pupil gets a place in its sub-pixel, a time and
//! a wavelength; the drift moves its place; the wavelength snaps to the nearest table; the losses and the landing centre are
//! interpolated between the four nearest nodes, the spread is the nearest one's; the landing point decides the cone, which takes
//! its draws for direction, absorption and isomerization.
//!
//! # As printed
//! "The entry closest to, but not above the random value" of a cumulative table gives the sample; the photon lands at its centre.
//! Scattered light (§19 throws it away) is added where an experiment asks for it: a photon that has passed the media is scattered with the
//! probability s of `stray` and falls elsewhere, and each cone counts a Poisson number of the mean of `stray` more, which is all
//! photons' scattered light, that from beyond the window with it. These spreads end with their window: between it and 0.5° this engine
//! has no skirt.
//! The printed SCE-I factor depends on the cone's own pointing only; the part common to all cones, which other engines have as
//! an apodization, is its mean here, so that engines can be compared.

mod scattered;
pub(crate) mod spread;

use glam::DVec2;
use rayon::prelude::*;

use crate::cone::ISOMERIZATION;
use crate::display::Emitter;
use crate::experiment::{Experiment, PaperSettings};
use crate::exposure::cones::ConeTable;
use crate::exposure::inputs::Inputs;
use crate::exposure::light::{Course, Shown, courses, courses_at, frame_light, light};
use crate::exposure::primaries::Primaries;
use crate::exposure::scene::Scene;
use crate::exposure::source::Projector;
use crate::exposure::spectral::{Absorbers, Paths};
use crate::exposure::stray::Veil;
use crate::exposure::turned::{Displaced, Turn, Turning};
use crate::optics::{BeamField, Projection};
use crate::report::PhotonBudget;
use crate::retina::{ConeIndex, ConeType};
use crate::rng::{Purpose, Stream};
use crate::spectrum::MIN_NM;
use scattered::Scattered;
use spread::Spread;

/// Spacing of wavelengths, nm.
const CHANNEL_NM: f64 = 10.0;
/// Number of channels from 390 to 830 nm.
const CHANNELS: usize = 45;
/// µm of retina per unit tangent that turns that spacing into one on the screen.
const UM_PER_TANGENT: f64 = 16_440.0;
/// Pixels in one piece of work.
const CHUNK: usize = 64;

/// The optics of one point of the screen in one channel.
struct Node {
    spread: Spread,
    /// Landing point of the chief ray, µm.
    landing_um: DVec2,
    /// Share that is not reflected, and transmittance of cornea, lens and macula.
    passed: [f64; 4],
}

/// A cone's own numbers.
struct Catch {
    /// Share of photons that it guides.
    guided: f64,
    /// Axial density of its pigment times ln 10.
    density: f64,
    cone_type: ConeType,
}

/// The prepared engine.
pub struct Paper {
    settings: PaperSettings,
    seed: u64,
    /// `[type][channel]`, peak 1.
    absorbance: [Vec<f64>; 3],
    /// `[channel]`.
    paths: Vec<Paths>,
    scene: Scene,
    index: ConeIndex,
    cones: Vec<Catch>,
    absorbers: Absorbers,
    /// First node on the screen (unit tangents), number of nodes.
    origin: DVec2,
    nodes: [usize; 2],
    /// `[node][channel]`.
    optics: Vec<Vec<Option<Node>>>,
    /// Cumulative share of each emitter's photons by channel.
    channels: Vec<Vec<f64>>,
    slant: Vec<f64>,
    /// How the cones see the screen as the eye turns.
    turning: Option<Turning>,
    beams: BeamField,
    /// Whether reflections are computed.
    reflects: bool,
    scattered: Option<Scattered>,
}

#[derive(Clone)]
struct Tally {
    counts: Vec<u32>,
    budget: PhotonBudget,
    /// Photons scattered out of the image.
    scattered: u64,
}

impl Paper {
    /// Prepares tables and cones.
    ///
    /// # Errors
    /// When a node of the screen is not seen.
    pub fn new(experiment: &Experiment, inputs: &Inputs, table: &ConeTable) -> Result<Self, String> {
        let Inputs { retina, projection, scene, pointing, primaries, .. } = inputs;
        let Primaries { kernels, projector } = primaries;
        // Take what each cone does with photons.
        let absorbers = kernels.spec().absorbers()?;
        let columns = crate::exposure::cone_columns(experiment, retina)?;
        let cones = (0..retina.len())
            .map(|i| {
                let [px, py] = retina.pointing[i];
                let cone_type = retina.cone_type[i];
                Catch {
                    guided: kernels.throughput()
                        * pointing.as_ref().map_or(1.0, |p| p.factor(f64::from(px).hypot(f64::from(py)))),
                    density: std::f64::consts::LN_10
                        * absorbers.pigments.density(cone_type, columns.ecc_deg[i]),
                    cone_type,
                }
            })
            .collect();
        let absorbance = [ConeType::L, ConeType::M, ConeType::S].map(|cone_type| {
            let at = |c| absorbers.pigments.absorbance(cone_type, MIN_NM + CHANNEL_NM * c as f64);
            (0..CHANNELS).map(at).collect()
        });
        // Lay nodes over the window, and find the channels that hold light.
        let step = experiment.counts.paper.node_um / UM_PER_TANGENT;
        let corner = |px: f64, py: f64| scene.tangent(DVec2::new(px, py));
        let (width, height) = (f64::from(scene.size_px[0]), f64::from(scene.size_px[1]));
        let (from, to) = (corner(0.0, height), corner(width, 0.0));
        let origin = (from / step).floor() * step;
        let nodes = [0, 1].map(|axis| ((to[axis] - origin[axis]) / step).ceil().max(1.0) as usize + 1);
        let channels: Vec<_> = projector.emitters.iter().map(cumulative_channels).collect();
        let lit = |c| projector.emitters.iter().flat_map(|e| &e.photons).any(|p| channel(p.nm) == c);
        let used: Vec<bool> = (0..CHANNELS).map(lit).collect();
        let veil = |stray| Veil::new((experiment, inputs), primaries, table, stray);
        let veil = experiment.eye.stray_light.map(veil).transpose()?;
        let throughput = kernels.throughput();
        let mut paper = Self {
            settings: experiment.counts.paper,
            seed: experiment.noise_seed(),
            absorbance,
            paths: (0..CHANNELS).map(|c| kernels.paths_at(MIN_NM + CHANNEL_NM * c as f64)).collect(),
            scene: scene.clone(),
            index: ConeIndex::new(retina),
            cones,
            absorbers,
            origin,
            nodes,
            optics: Vec::new(),
            channels,
            slant: slants(projector, &inputs.beams, scene),
            turning: inputs.turning(experiment),
            beams: inputs.beams.clone(),
            reflects: experiment.eye.reflection_losses,
            scattered: veil.map(|veil| Scattered { veil, ids: retina.id.clone(), throughput }),
        };
        // Compute the point spread of every node and channel.
        let apodize = experiment.eye.stiles_crawford_rho10_per_mm2;
        let jobs: Vec<(usize, usize)> =
            (0..nodes[0] * nodes[1]).flat_map(|node| (0..CHANNELS).map(move |c| (node, c))).collect();
        let optics: Vec<Option<Node>> = jobs
            .par_iter()
            .map(
                |&(node, c)| {
                    if used[c] { paper.node(projection, node, c, apodize).map(Some) } else { Ok(None) }
                },
            )
            .collect::<Result<_, String>>()?;
        let mut optics = optics.into_iter();
        paper.optics = (0..nodes[0] * nodes[1]).map(|_| optics.by_ref().take(CHANNELS).collect()).collect();
        Ok(paper)
    }

    /// The point spread of one node and channel.
    fn node(&self, projection: &Projection, node: usize, channel: usize, rho: f64) -> Result<Node, String> {
        let step = self.settings.node_um / UM_PER_TANGENT;
        let place = DVec2::new((node % self.nodes[0]) as f64, (node / self.nodes[0]) as f64);
        let tangent = self.origin + place * step;
        let nm = MIN_NM + CHANNEL_NM * channel as f64;
        let mut rays = Stream::new(self.seed, Purpose::Rays, 0, (node * CHANNELS + channel) as u64);
        let spread = Spread::new(projection, projection.object(tangent), nm, &self.settings, rho, &mut rays)?;
        let media = &self.absorbers.media;
        Ok(Node {
            spread,
            landing_um: projection.retina_um(tangent, nm).map_err(|e| e.to_string())?,
            passed: [
                1.0 - media.reflected(nm),
                media.cornea(nm, self.paths[channel].cornea) / (1.0 - media.reflected(nm)),
                media.lens(nm, self.paths[channel].lens),
                media.macula(nm, projection.screen().eccentricity_deg(tangent)),
            ],
        })
    }

    /// Simulates one frame: counts by cone and the fates of its photons.
    pub fn frame(&self, shown: &Shown, projector: &Projector) -> (Vec<u32>, PhotonBudget) {
        let display = &projector.display;
        let layers: Vec<Vec<Course>> =
            projector.emitters.iter().map(|emitter| courses(emitter, display, shown.index)).collect();
        let turn = self.turning.as_ref().map(|turning| turning.in_frame(shown.index));
        let [width, height] = self.scene.size_px.map(|s| s as usize);
        let chunks: Vec<(usize, usize)> = (0..projector.emitters.len())
            .flat_map(|k| (0..(width * height).div_ceil(CHUNK)).map(move |c| (k, c)))
            .collect();
        let empty =
            || Tally { counts: vec![0; self.cones.len()], budget: PhotonBudget::default(), scattered: 0 };
        // Counts and fates are whole numbers, so their sums do not depend on the order.
        let mut tally = chunks
            .par_iter()
            .fold(empty, |mut tally, &(k, chunk)| {
                let mut stream = Stream::new(
                    self.seed,
                    Purpose::Photons,
                    u64::from(shown.index),
                    ((k as u64) << 40) | chunk as u64,
                );
                for pixel in chunk * CHUNK..((chunk + 1) * CHUNK).min(width * height) {
                    let shown = (shown, turn.as_ref());
                    self.pixel(shown, projector, &layers[k], (k, pixel), &mut stream, &mut tally);
                }
                tally
            })
            .reduce(empty, |mut a, b| {
                a.counts.iter_mut().zip(&b.counts).for_each(|(x, y)| *x = x.saturating_add(*y));
                a.budget.add(&b.budget);
                a.scattered += b.scattered;
                a
            });
        if let Some(scattered) = &self.scattered {
            scattered.count((shown, projector), self, &mut tally);
        }
        let mut emitted = 0.0;
        for (emitter, courses) in projector.emitters.iter().zip(&layers) {
            let places = (0..display.height_px).flat_map(|row| (0..display.width_px).map(move |c| [c, row]));
            let light: f64 = places.map(|at| frame_light(display, emitter, courses, shown, at)).sum();
            emitted += emitter.emitted() * light;
        }
        let entered = tally.budget.fates();
        tally.budget.emitted = emitted;
        tally.budget.missed_pupil = emitted - entered;
        (tally.counts, tally.budget)
    }

    /// All photons of one pixel of the window from one emitter.
    fn pixel(
        &self,
        (shown, turn): (&Shown, Option<&Turn>),
        projector: &Projector,
        courses: &[Course],
        (k, pixel): (usize, usize),
        stream: &mut Stream,
        tally: &mut Tally,
    ) {
        let emitter = &projector.emitters[k];
        let width = self.scene.size_px[0] as usize;
        let (column, row) = (pixel % width, pixel / width);
        let at = [self.scene.first_px[0] + column as u32, self.scene.first_px[1] + row as u32];
        let seconds = 1.0 / projector.display.frame_rate_hz;
        let corner = DVec2::new(column as f64, row as f64);
        let (displaced, entering) = turn.map_or((Displaced::AT_REST, self.slant[pixel]), |turn| {
            let moved = projector.gaze.screen_tangent((f64::from(shown.index) + 0.5) * seconds);
            let moved_px = DVec2::new(moved.x, -moved.y) / self.scene.tangent_per_px;
            let light = (projector.display.emission_law, &self.beams);
            turn.entering(corner + 0.5 - moved_px, &self.scene, light)
        });
        let corner = corner - displaced.apart;
        // On a scanned screen each pixel has a time of its own.
        let own = emitter.waveform.scan().map(|scan| {
            courses_at(emitter, &projector.display, shown.index, scan.delay(&projector.display, at))
        });
        for course in own.as_deref().unwrap_or(courses) {
            let light = course.share() * light(&projector.display, emitter, course.shows, shown, at);
            let mean = light * emitter.emitted() * projector.pupil_share * entering;
            for _ in 0..crate::exposure::poisson::from_stream(stream, mean) as u64 {
                let place = corner + 0.5 + displaced.stretch * (Self::place(emitter, stream) - 0.5);
                let time = (f64::from(shown.index) + course.time(stream.uniform())) * seconds;
                let lands = self.scene.tangent(place) - projector.gaze.screen_tangent(time);
                let uniform = stream.uniform();
                let channel = self.channels[k].partition_point(|c| *c <= uniform).min(CHANNELS - 1);
                self.photon(lands, channel, stream, tally);
            }
        }
    }

    /// A point of the emitter's rectangles and spot, pixel units.
    fn place(emitter: &Emitter, stream: &mut Stream) -> DVec2 {
        let [x0, y0, x1, y1] = emitter.rect(stream.uniform());
        let place = DVec2::new(x0 + (x1 - x0) * stream.uniform(), y0 + (y1 - y0) * stream.uniform());
        if emitter.spot_sd_px <= 0.0 {
            return place;
        }
        let (x, y) = stream.normal_pair();
        place + emitter.spot_sd_px * DVec2::new(x, y)
    }

    /// One photon in the pupil, seen at a point of the screen.
    fn photon(&self, seen: DVec2, channel: usize, stream: &mut Stream, tally: &mut Tally) {
        let grid = (seen - self.origin) / (self.settings.node_um / UM_PER_TANGENT);
        let most = DVec2::new((self.nodes[0] - 2) as f64, (self.nodes[1] - 2) as f64);
        let cell = grid.floor().clamp(DVec2::ZERO, most);
        let t = grid - cell;
        let (x, y) = (cell.x as usize, cell.y as usize);
        let mut passed = [0.0; 4];
        let mut centre = DVec2::ZERO;
        for (dx, dy, weight) in [
            (0, 0, (1.0 - t.x) * (1.0 - t.y)),
            (1, 0, t.x * (1.0 - t.y)),
            (0, 1, (1.0 - t.x) * t.y),
            (1, 1, t.x * t.y),
        ] {
            let Some(node) = &self.optics[(y + dy) * self.nodes[0] + x + dx][channel] else {
                return;
            };
            centre += weight * node.landing_um;
            (0..4).for_each(|i| passed[i] += weight * node.passed[i]);
        }
        // The filters before the retina; where nothing is reflected no number is drawn.
        let Tally { budget, scattered, .. } = tally;
        let fates = [&mut budget.reflected, &mut budget.cornea, &mut budget.lens, &mut budget.macula];
        for (i, (fate, share)) in fates.into_iter().zip(passed).enumerate() {
            if (i > 0 || self.reflects) && stream.uniform() >= share {
                *fate += 1.0;
                return;
            }
        }
        // Scattered photons fall elsewhere; no number is drawn where none are.
        if let Some(Scattered { veil, .. }) = &self.scattered
            && stream.uniform() >= veil.kept()
        {
            *scattered += 1;
            return;
        }
        // The landing point, from the nearest node's spread.
        let near = (y + usize::from(t.y > 0.5)) * self.nodes[0] + x + usize::from(t.x > 0.5);
        let Some(node) = &self.optics[near][channel] else {
            return;
        };
        let landed = centre + node.spread.draw(stream.uniform());
        self.cone(landed, channel, stream, tally);
    }

    /// What the cone at a landing point does with the photon.
    fn cone(&self, landed: DVec2, channel: usize, stream: &mut Stream, tally: &mut Tally) {
        let Some(owner) = self.index.owner(landed) else {
            tally.budget.between_cones += 1.0;
            return;
        };
        let cone = &self.cones[owner as usize];
        if stream.uniform() >= cone.guided {
            tally.budget.stiles_crawford += 1.0;
            return;
        }
        // A cone of a population may accept more than the law's peak (`cone::directional`): the excess goes into what it absorbs.
        let absorptance = -(-cone.density * self.absorbance[cone.cone_type as usize][channel]).exp_m1()
            * cone.guided.max(1.0);
        if stream.uniform() >= absorptance {
            tally.budget.not_absorbed += 1.0;
        } else if stream.uniform() >= ISOMERIZATION {
            tally.budget.not_isomerized += 1.0;
        } else {
            tally.counts[owner as usize] = tally.counts[owner as usize].saturating_add(1);
            tally.budget.isomerized[cone.cone_type as usize] += 1.0;
        }
    }
}

/// The wavelength (nm) that a photon is given.
pub(crate) fn snapped_nm(nm: f64) -> f64 {
    MIN_NM + CHANNEL_NM * channel(nm) as f64
}

fn channel(nm: f64) -> usize {
    (((nm - MIN_NM) / CHANNEL_NM).round().max(0.0) as usize).min(CHANNELS - 1)
}

/// Cumulative share of an emitter's photons by channel, each photon in the channel nearest to its wavelength.
fn cumulative_channels(emitter: &Emitter) -> Vec<f64> {
    let mut shares = vec![0.0; CHANNELS];
    for photon in &emitter.photons {
        shares[channel(photon.nm)] += photon.emitted;
    }
    let total = emitter.emitted().max(f64::MIN_POSITIVE);
    let mut sum = 0.0;
    shares
        .into_iter()
        .map(|share| {
            sum += share;
            sum / total
        })
        .collect()
}

/// Slant factors of the window's pixels.
fn slants(projector: &Projector, beams: &BeamField, scene: &Scene) -> Vec<f64> {
    let [width, height] = scene.size_px;
    let mut slants = Vec::with_capacity((width * height) as usize);
    for row in 0..height {
        for column in 0..width {
            let tangent = scene.tangent(DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5));
            slants.push(crate::exposure::cones::entering(projector.display.emission_law, beams, tangent));
        }
    }
    slants
}
