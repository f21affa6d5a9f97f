//! Neighbour graph and receptive fields (§15.4) of a retina as CSV. Cones are named by their row in the cone table.

use std::io::{BufWriter, Write};
use std::path::Path;

use glam::DVec2;
use photoneye_eye::retina::{NeighbourGraph, ReceptiveField, Retina, Role};

use crate::cli_optics::RetinaArgs;
use crate::failure::Failure;
use crate::result_folder::write_with;

/// Writes what was asked for; `is_row` says which cones are in the table.
pub fn write(args: &RetinaArgs, retina: &Retina, is_row: impl Fn(DVec2) -> bool) -> Result<(), Failure> {
    let graph = NeighbourGraph::new(retina);
    let mut next = 0_u32;
    let rows: Vec<Option<u32>> = (0..retina.len())
        .map(|cone| {
            let row = is_row(retina.center(cone)).then_some(next);
            next += u32::from(row.is_some());
            row
        })
        .collect();
    let row_of = |cone: u32| rows.get(cone as usize).copied().flatten();
    let all = 0..retina.len() as u32;
    if let Some(path) = &args.neighbours {
        csv(path, "cone,neighbour", |out| {
            for cone in all.clone() {
                for &other in graph.neighbours(cone).iter().filter(|&&other| other > cone) {
                    if let (Some(a), Some(b)) = (row_of(cone), row_of(other)) {
                        writeln!(out, "{a},{b}")?;
                    }
                }
            }
            Ok(())
        })?;
    }
    if let Some(path) = &args.fields {
        let (centre, surround) =
            (usize::from(args.centre_generations), usize::from(args.surround_generations));
        csv(path, "field,cone,generation,role", |out| {
            for cone in all.clone().filter(|&cone| row_of(cone).is_some()) {
                let field = ReceptiveField::new(&graph, cone, centre, surround);
                for member in field.rows() {
                    let role = match member.role {
                        Role::Centre => "centre",
                        Role::Surround => "surround",
                    };
                    if let (Some(a), Some(b)) = (row_of(member.field), row_of(member.cone)) {
                        writeln!(out, "{a},{b},{},{role}", member.generation)?;
                    }
                }
            }
            Ok(())
        })?;
    }
    Ok(())
}

fn csv(
    path: &Path,
    header: &str,
    write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), Failure> {
    write_with(path, |file| {
        let mut out = BufWriter::new(file);
        writeln!(out, "{header}")
            .and_then(|()| write(&mut out))
            .and_then(|()| out.flush())
            .map_err(|e| Failure::file("write", path, &e))
    })
}
