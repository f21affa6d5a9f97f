//! `trace`: given rays through the unaccommodated eye.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use glam::DVec3;
use photoneye_eye::optics::{Dispersion, EyeState, Ray, RayFate, SchematicEye, Traced};

use super::Context;
use super::eyes::asked_for;
use crate::cli_optics::TraceArgs;
use crate::failure::{Failure, plain};
use crate::output;
use crate::result_folder::write_file;

const HEADER: &str = "lam_nm,dispersion,n_cornea,n_aqueous,n_lens,n_vitreous,Px,Py,Pz,Sx,Sy,Sz,\
    corneaF_x,corneaF_y,corneaF_z,corneaB_x,corneaB_y,corneaB_z,stop_x,stop_y,stop_z,lensF_x,lensF_y,lensF_z,\
    lensB_x,lensB_y,lensB_z,retina_x,retina_y,retina_z,Ox,Oy,Oz,OPL_mm,fate";
const SURFACES: [&str; 5] = ["cornea_front", "cornea_back", "lens_front", "lens_back", "retina"];

/// One row of the file.
struct Given {
    ray: Ray,
    wavelength_nm: f64,
    dispersion: Dispersion,
}

/// Runs the command.
pub fn run(context: &Context, args: &TraceArgs) -> Result<(), Failure> {
    let name = args.rays.display();
    let text =
        std::fs::read_to_string(&args.rays).map_err(|e| Failure::usage(format!("{name}: {}", plain(&e))))?;
    let (prescription, state) = asked_for(&args.eye)?;
    let rays = read(&text, state.dispersion).map_err(|why| Failure::usage(format!("{name}: {why}")))?;
    // An eye for each law that the file names.
    let mut eyes: Vec<(Dispersion, SchematicEye)> = Vec::new();
    let mut table = format!("{HEADER}\n");
    let mut fates: BTreeMap<String, usize> = BTreeMap::new();
    for given in &rays {
        let asked = |(law, _): &&(Dispersion, SchematicEye)| *law == given.dispersion;
        if !eyes.iter().any(|eye| asked(&eye)) {
            let state = EyeState { pupil_mm: args.pupil_mm, dispersion: given.dispersion, ..state };
            let eye = SchematicEye::new(&prescription, &state).map_err(Failure::usage)?;
            eyes.push((given.dispersion, eye));
        }
        let Some((_, eye)) = eyes.iter().find(asked) else { continue };
        let traced = eye.trace(&given.ray, given.wavelength_nm);
        *fates.entry(fate(traced.fate)).or_default() += 1;
        row(&mut table, given, &eye.indices(given.wavelength_nm), &traced);
    }
    write_file(&args.out, table.as_bytes())?;
    let arrived = fates.get(&fate(RayFate::Arrived)).copied().unwrap_or(0);
    if context.json {
        return output::json(
            &serde_json::json!({"rays": rays.len(), "arrived": arrived, "fates": fates, "out": args.out}),
        );
    }
    output::line(format_args!("{} ray(s), {arrived} reach the retina through the pupil", rays.len()))?;
    for (fate, count) in fates.iter().filter(|(name, _)| **name != fate(RayFate::Arrived)) {
        output::line(format_args!("  {count} {fate}"))?;
    }
    Ok(())
}

/// Reads the rays by the names in the first line.
fn read(text: &str, default: Dispersion) -> Result<Vec<Given>, String> {
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (_, header) = lines.next().ok_or("the file is empty")?;
    let names: Vec<String> = header.split(',').map(|name| name.trim().to_lowercase()).collect();
    let place = |name: &str| names.iter().position(|other| other == name);
    let need = |name: &str| place(name).ok_or_else(|| format!("there is no column `{name}`"));
    let vector = |names: [&str; 3]| -> Result<[usize; 3], String> {
        Ok([need(names[0])?, need(names[1])?, need(names[2])?])
    };
    let (origin, direction) = (vector(["px", "py", "pz"])?, vector(["sx", "sy", "sz"])?);
    let wavelength = place("wavelength_nm").map_or_else(|| need("lam_nm"), Ok);
    let wavelength = wavelength.map_err(|_| "there is no column `wavelength_nm`")?;
    let dispersion = place("dispersion");
    let mut rays = Vec::new();
    for (number, line) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let at = |why: String| format!("line {}: {why}", number + 1);
        let value = |column: usize| -> Result<f64, String> {
            let cell = cells.get(column).copied().unwrap_or_default();
            let value = cell.parse::<f64>().ok().filter(|value| value.is_finite());
            value.ok_or_else(|| at(format!("`{cell}` in column `{}` is not a number", names[column])))
        };
        let point = |c: [usize; 3]| Ok::<_, String>(DVec3::new(value(c[0])?, value(c[1])?, value(c[2])?));
        let ray = Ray::new(point(origin)?, point(direction)?).map_err(|error| at(error.to_string()))?;
        let wavelength_nm = value(wavelength)?;
        if !(365.0..=1014.0).contains(&wavelength_nm) {
            return Err(at(format!("wavelength_nm: {wavelength_nm} is outside 365 to 1014")));
        }
        let name = dispersion.and_then(|column| cells.get(column)).copied().unwrap_or_default();
        let dispersion = match name.to_lowercase().as_str() {
            "" => default,
            "polyline" => Dispersion::Polyline,
            "herzberger" => Dispersion::Herzberger,
            "quadratic" => Dispersion::Quadratic,
            other => {
                return Err(at(format!("dispersion: `{other}` is not polyline, herzberger or quadratic")));
            }
        };
        rays.push(Given { ray, wavelength_nm, dispersion });
    }
    Ok(rays)
}

/// Writes one row; a surface that was not met leaves its cells empty.
fn row(table: &mut String, given: &Given, indices: &[f64; 5], traced: &Traced) {
    let mut cells = vec![given.wavelength_nm.to_string(), given.dispersion.name().to_lowercase()];
    cells.extend(indices[1..].iter().map(f64::to_string));
    let mut point = |point: Option<DVec3>| match point {
        Some(p) => cells.extend(p.to_array().map(|value| value.to_string())),
        None => cells.extend(std::iter::repeat_n(String::new(), 3)),
    };
    point(Some(given.ray.origin()));
    point(Some(given.ray.direction()));
    let [cornea_front, cornea_back, lens_front, lens_back, retina] = traced.hits;
    for hit in [cornea_front, cornea_back, traced.stop, lens_front, lens_back, retina] {
        point(hit);
    }
    point(retina.map(|_| traced.direction));
    cells.push(if retina.is_some() { traced.optical_path_mm.to_string() } else { String::new() });
    cells.push(fate(traced.fate));
    // Writing to a String cannot fail.
    let _ = writeln!(table, "{}", cells.join(","));
}

fn fate(fate: RayFate) -> String {
    let surface = |k: usize| SURFACES.get(k).copied().unwrap_or("surface");
    match fate {
        RayFate::Arrived => "arrived".into(),
        RayFate::StoppedByIris => "stopped_by_iris".into(),
        RayFate::MissedSurface(k) => format!("missed_{}", surface(k)),
        RayFate::TotalInternalReflection(k) => format!("reflected_at_{}", surface(k)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_rows_are_named() {
        let read = |text: &str| read(text, Dispersion::Polyline).map(|rays| rays.len());
        let head = "px,py,pz,sx,sy,sz,wavelength_nm,dispersion\n";
        assert_eq!(read(&format!("{head}0,0,-30,0,0,2,543,\n0,1,-30,0,0,1,543,herzberger\n")), Ok(2));
        for (row, word) in [
            ("0,0,-30,0,0,0,543,", "line 2"),
            ("0,0,x,0,0,1,543,", "pz"),
            ("0,0,-30,0,0,1,20,", "wavelength_nm"),
            ("0,0,-30,0,0,1,543,other", "dispersion"),
            ("0,0", "not a number"),
        ] {
            let error = read(&format!("{head}{row}\n")).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
        assert!(read("px\n").unwrap_err().contains("py"));
    }
}
