//! Cardinal values by paraxial tracing: n' u' = n u − y φ at a surface, y' = y + u t between surfaces.
//!
//! Toric surfaces count with their mean curvature; a lens with a gradient is followed by its paraxial ray equation.
//! Distances in mm from the corneal apex, powers in dioptres.

use super::schematic_eye::SchematicEye;
use glam::DVec3;

/// Paraxial values of an eye at one wavelength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cardinal {
    /// Equivalent power, D.
    pub power_d: f64,
    /// z of the entrance pupil.
    pub entrance_pupil_z_mm: f64,
    /// Entrance pupil size / stop size.
    pub stop_magnification: f64,
    /// z of the exit pupil.
    pub exit_pupil_z_mm: f64,
    /// Exit pupil size / stop size.
    pub exit_magnification: f64,
    /// z of the first nodal point.
    pub first_nodal_z_mm: f64,
    /// z of the second nodal point.
    pub second_nodal_z_mm: f64,
}

impl SchematicEye {
    /// The cardinal values at a vacuum wavelength (nm).
    pub fn cardinal(&self, wavelength_nm: f64) -> Cardinal {
        let n = self.indices(wavelength_nm);
        let z: [f64; 4] = std::array::from_fn(|k| self.surfaces[k].conic.vertex_z);
        // The index just before the lens back, which differs from that of its front in a gradient.
        let lens = self.gradient.as_ref();
        let n_back = lens.map_or(n[3], |lens| lens.smooth_index_at(n[3], DVec3::new(0.0, 0.0, z[3])));
        let phi: [f64; 4] = std::array::from_fn(|k| {
            let before = if k == 3 { n_back } else { n[k] };
            (n[k + 1] - before) / self.surfaces[k].conic.radius
        });
        // Forward from surface `from`, starting with height y and reduced angle nu before it.
        let forward = |from: usize, mut y: f64, mut nu: f64| {
            for k in from..4 {
                nu -= y * phi[k];
                if let (Some(lens), 2) = (lens, k) {
                    (y, nu) = lens.paraxial(n[3], z[3] - z[2], y, nu, false);
                } else if k < 3 {
                    y += nu / n[k + 1] * (z[k + 1] - z[k]);
                }
            }
            (y, nu)
        };
        // Backward from height y and reduced angle nu just behind surface `from`.
        let backward = |from: usize, mut y: f64, mut nu: f64| {
            for k in (0..=from).rev() {
                nu += y * phi[k];
                if let (Some(lens), 3) = (lens, k) {
                    (y, nu) = lens.paraxial(n[3], z[3] - z[2], y, nu, true);
                } else if k > 0 {
                    y -= nu / n[k] * (z[k] - z[k - 1]);
                }
            }
            (y, nu)
        };
        // A parallel ray each way: power and focal points.
        let (y_back, nu_back) = forward(0, 1.0, 0.0);
        let (y_front, nu_front) = backward(3, 1.0, 0.0);
        let power = -nu_back;
        let back_focus = z[3] - y_back * n[4] / nu_back;
        let front_focus = -y_front / nu_front;
        // A ray through the stop's centre each way: the pupils. nu is kept by imaging times size.
        let (y_in, nu_in) = backward(1, -(self.stop_z - z[1]) / n[2], 1.0);
        let (y_out, nu_out) = forward(2, (z[2] - self.stop_z) / n[2], 1.0);
        Cardinal {
            power_d: power * 1e3,
            entrance_pupil_z_mm: -y_in / nu_in,
            stop_magnification: 1.0 / nu_in,
            exit_pupil_z_mm: z[3] - y_out * n[4] / nu_out,
            exit_magnification: 1.0 / nu_out,
            first_nodal_z_mm: front_focus + n[4] / power,
            second_nodal_z_mm: back_focus - 1.0 / power,
        }
    }
}
