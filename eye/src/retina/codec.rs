//! Stored form of tiles and retinas: little-endian, own format.
//!
//! magic (8 bytes) | version u32 | place (4 x f64: i, j, 0, 0 or the region) | length of the parameters u32 |
//! parameters (postcard) | counts (7 x u64) | cones n u32 | corners c u32 | id n x u64 | x n x f64 | y n x
//! f64 | polygon_start (n + 1) x u32 | polygon_xy 2c x f32 | cell area n x f32 | aperture n x f32 | pointing
//! 2n x f32 | type, and 4 more at an edge, n x u8 | BLAKE3 of all before (32 bytes). A reader checks magic,
//! version, total length and digest before it allocates.

use glam::DVec2;

use super::mosaic::{ConeType, Cones, Counts, Retina, RetinaTile};
use super::params::{RetinaError, RetinaParams};
use super::tile::{RegionUm, TileId};

const TILE_MAGIC: [u8; 8] = *b"PHEYTILE";
const RETINA_MAGIC: [u8; 8] = *b"PHEYRETI";
const VERSION: u32 = 2;
const DIGEST: usize = 32;
/// Added to the type of a cone at an edge.
const EDGE: u8 = 4;

const fn damaged() -> RetinaError {
    RetinaError::Bytes("damaged or cut short")
}

/// Takes values from the front of checked bytes.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, n: usize) -> Result<&'a [u8], RetinaError> {
        let (head, rest) = self.0.split_at_checked(n).ok_or_else(damaged)?;
        self.0 = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], RetinaError> {
        self.bytes(N)?.try_into().map_err(|_| damaged())
    }

    fn u32(&mut self) -> Result<u32, RetinaError> {
        self.array().map(u32::from_le_bytes)
    }

    /// `n` values of N bytes; the length is checked before anything is allocated.
    fn values<const N: usize, T>(
        &mut self,
        n: usize,
        from: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>, RetinaError> {
        let bytes = self.bytes(n.checked_mul(N).ok_or_else(damaged)?)?;
        Ok(bytes.as_chunks::<N>().0.iter().map(|&chunk| from(chunk)).collect())
    }
}

fn encode(magic: [u8; 8], place: [f64; 4], params: &RetinaParams, cones: &Cones) -> Vec<u8> {
    // A parameter set always encodes; were it not so, the reader would refuse the empty one.
    let params = postcard::to_stdvec(params).unwrap_or_default();
    let n = cones.len();
    let mut out = Vec::with_capacity(160 + params.len() + 49 * n + 4 * cones.polygon_xy.len());
    out.extend(magic);
    out.extend(VERSION.to_le_bytes());
    out.extend(place.iter().flat_map(|v| v.to_le_bytes()));
    out.extend((params.len() as u32).to_le_bytes());
    out.extend(&params);
    out.extend(cones.counts.to_array().iter().flat_map(|v| v.to_le_bytes()));
    out.extend((n as u32).to_le_bytes());
    out.extend((cones.polygon_xy.len() as u32 / 2).to_le_bytes());
    out.extend(cones.id.iter().flat_map(|v| v.to_le_bytes()));
    out.extend(cones.x_um.iter().chain(&cones.y_um).flat_map(|v| v.to_le_bytes()));
    if cones.polygon_start.is_empty() {
        out.extend(0_u32.to_le_bytes());
    }
    out.extend(cones.polygon_start.iter().flat_map(|v| v.to_le_bytes()));
    let singles = cones.polygon_xy.iter().chain(&cones.cell_area_um2).chain(&cones.aperture_um2);
    out.extend(singles.chain(cones.pointing.as_flattened()).flat_map(|v| v.to_le_bytes()));
    out.extend(cones.cone_type.iter().zip(&cones.edge).map(|(&t, &edge)| t as u8 + EDGE * u8::from(edge)));
    let digest = blake3::hash(&out);
    out.extend(digest.as_bytes());
    out
}

fn decode(magic: [u8; 8], bytes: &[u8]) -> Result<([f64; 4], RetinaParams, Cones), RetinaError> {
    let end = bytes.len().checked_sub(DIGEST).ok_or_else(damaged)?;
    let (body, digest) = bytes.split_at(end);
    let mut r = Reader(body);
    if r.array::<8>()? != magic {
        return Err(RetinaError::Bytes("not of this kind"));
    }
    if r.u32()? != VERSION {
        return Err(RetinaError::Bytes("of another version"));
    }
    if blake3::hash(body).as_bytes() != digest {
        return Err(damaged());
    }
    let mut place = [0.0; 4];
    for v in &mut place {
        *v = f64::from_le_bytes(r.array()?);
    }
    let length = r.u32()? as usize;
    let params = postcard::from_bytes(r.bytes(length)?).map_err(|_| damaged())?;
    let mut counts = [0; 7];
    for v in &mut counts {
        *v = u64::from_le_bytes(r.array()?);
    }
    let (n, corners) = (r.u32()? as usize, r.u32()? as usize);
    let types = |b: [u8; 1]| {
        let cone_type = match b[0] % EDGE {
            0 => ConeType::L,
            1 => ConeType::M,
            2 => ConeType::S,
            _ => return None,
        };
        (b[0] < 2 * EDGE).then_some((cone_type, b[0] >= EDGE))
    };
    let mut cones = Cones {
        counts: Counts::from_array(counts),
        id: r.values(n, u64::from_le_bytes)?,
        x_um: r.values(n, f64::from_le_bytes)?,
        y_um: r.values(n, f64::from_le_bytes)?,
        polygon_start: r.values(n + 1, u32::from_le_bytes)?,
        polygon_xy: r.values(2 * corners, f32::from_le_bytes)?,
        cell_area_um2: r.values(n, f32::from_le_bytes)?,
        aperture_um2: r.values(n, f32::from_le_bytes)?,
        pointing: r.values(2 * n, f32::from_le_bytes)?.as_chunks::<2>().0.to_vec(),
        ..Cones::default()
    };
    (cones.cone_type, cones.edge) =
        r.values(n, types)?.into_iter().collect::<Option<_>>().ok_or_else(damaged)?;
    let starts = &cones.polygon_start;
    let sound = starts.first() == Some(&0) && starts.is_sorted() && starts.last() == Some(&(corners as u32));
    if !sound || !r.0.is_empty() {
        return Err(damaged());
    }
    Ok((place, params, cones))
}

impl RetinaTile {
    /// The stored form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let place = [f64::from(self.tile.i), f64::from(self.tile.j), 0.0, 0.0];
        encode(TILE_MAGIC, place, &self.params, &self.cones)
    }

    /// Reads the stored form.
    ///
    /// # Errors
    /// `RetinaError::Bytes` when it is something else, of another version, or damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, RetinaError> {
        let ([i, j, ..], params, cones) = decode(TILE_MAGIC, bytes)?;
        Ok(Self { tile: TileId { i: i as i32, j: j as i32 }, params, cones })
    }
}

impl Retina {
    /// The stored form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let (min, max) = (self.region.min, self.region.max);
        encode(RETINA_MAGIC, [min.x, min.y, max.x, max.y], &self.params, &self.cones)
    }

    /// Reads the stored form.
    ///
    /// # Errors
    /// `RetinaError::Bytes` when it is something else, of another version, or damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, RetinaError> {
        let ([x0, y0, x1, y1], params, cones) = decode(RETINA_MAGIC, bytes)?;
        let region = RegionUm { min: DVec2::new(x0, y0), max: DVec2::new(x1, y1) };
        Ok(Self { region, params, cones })
    }
}
