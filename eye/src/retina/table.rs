//! The text of a measured mosaic: checked rows of places and types.
//!
//! Comma-separated lines with a header that names the columns `x_um`, `y_um` (µm of the chart) and `type` (L,
//! M, S or 0, 1, 2), in any order and any case; `aperture_um` (diameter of the disc that collects light) and
//! `id` (a whole number, each once) may be there; other columns are ignored. A type that was not classified
//! (empty, ?, U, unknown, NA, NaN) is refused, or taken as what the caller says. Lines that start with # and
//! empty lines are skipped; a byte-order mark, CRLF and values in double quotes (without line breaks in them)
//! are accepted.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_4;

use glam::DVec2;

use super::field::Field;
use super::mosaic::ConeType;
use super::params::RetinaError;
use super::relax::quantized;

/// Most rows of a table.
pub const MAX_ROWS: usize = 2_000_000;
/// Two cones are at least this far apart, µm of the chart: the narrowest inner segments are 1.4 µm wide. It also bounds the time that a
/// hostile table takes.
pub const LEAST_DISTANCE_UM: f64 = 1.0;
/// The columns needed.
const COLUMNS: [&str; 3] = ["x_um", "y_um", "type"];
/// The columns that may be there.
const MORE_COLUMNS: [&str; 2] = ["aperture_um", "id"];
/// Types of cones that were not classified.
const UNKNOWN: [&str; 6] = ["", "?", "U", "unknown", "NA", "NaN"];

/// Why a table is not a mosaic. Lines count from 1.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ImportError {
    /// No row.
    #[error("the table has no cone: give a header with x_um, y_um and type, and at least one row")]
    Empty,
    /// A column is not in the header.
    #[error("line {line}: no column {column:?} in the header {header:?}; needed are x_um, y_um and type")]
    MissingColumn {
        /// The line of the header.
        line: usize,
        /// The column.
        column: &'static str,
        /// The header found.
        header: String,
    },
    /// A column is in the header twice.
    #[error("line {line}: column {column:?} is there more than once in the header")]
    RepeatedColumn {
        /// The line of the header.
        line: usize,
        /// The column.
        column: &'static str,
    },
    /// A value is not what its column holds.
    #[error("line {line}, column {column:?}: {value:?} is not {allowed}")]
    Value {
        /// The line.
        line: usize,
        /// The column.
        column: &'static str,
        /// The text found; empty when the line is too short.
        value: String,
        /// What is allowed, in words.
        allowed: &'static str,
    },
    /// A cone lies where no cones live.
    #[error(
        "line {line}, columns x_um and y_um: ({x_um}, {y_um}) µm is outside the retina; allowed are places inside the ora (102 retinal degrees, 21,400 µm; nasal 111, temporal 93) and outside the optic disc"
    )]
    OutsideRetina {
        /// The line.
        line: usize,
        /// The place.
        x_um: f64,
        /// The place.
        y_um: f64,
    },
    /// A type was not classified.
    #[error(
        "line {line}, column \"type\": {value:?} is no type; allowed are L, M or S, or 0, 1 or 2, or \
         retina.mosaic.type_unknown"
    )]
    UnknownType {
        /// The line.
        line: usize,
        /// The text found.
        value: String,
    },
    /// Two cones have the same number.
    #[error("line {line}, column \"id\": {id} is the id of line {other} too")]
    RepeatedId {
        /// The later line.
        line: usize,
        /// The earlier line.
        other: usize,
        /// The number.
        id: u64,
    },
    /// Two cones are in one place.
    #[error(
        "line {line}, columns x_um and y_um: {distance_um:.3} µm from the cone of line {other}; allowed are {LEAST_DISTANCE_UM} µm or more"
    )]
    TooClose {
        /// The later line.
        line: usize,
        /// The earlier line.
        other: usize,
        /// Their distance, µm of the chart.
        distance_um: f64,
    },
    /// The table is too long.
    #[error("line {line}: more than {MAX_ROWS} cones")]
    TooMany {
        /// The first line too many.
        line: usize,
    },
    /// A parameter is out of range.
    #[error(transparent)]
    Params(#[from] RetinaError),
}

/// The rows of a table, field by field.
#[derive(Debug, Default)]
pub(super) struct Table {
    /// Line of the row, from 1.
    pub(super) line: Vec<usize>,
    /// Place, µm of the chart.
    pub(super) at: Vec<DVec2>,
    pub(super) cone_type: Vec<ConeType>,
    /// Numbers of the cones; those of the rows (from 0) where the table has none.
    pub(super) id: Vec<u64>,
    /// Area that collects light across the cone's direction, µm², where the table has it.
    pub(super) aperture_um2: Option<Vec<f64>>,
}

impl Table {
    /// Reads and checks all rows.
    pub(super) fn read(
        csv: &str,
        field: &Field,
        type_unknown: Option<ConeType>,
    ) -> Result<Self, ImportError> {
        let lines = csv.strip_prefix('\u{feff}').unwrap_or(csv).lines().enumerate();
        let mut lines = lines
            .map(|(k, text)| (k + 1, text.trim()))
            .filter(|(_, text)| !text.is_empty() && !text.starts_with('#'));
        let (line, header) = lines.next().ok_or(ImportError::Empty)?;
        let columns = columns(line, header)?;
        let [with_aperture, with_id] = MORE_COLUMNS.map(|column| column_at(line, header, column));
        let (with_aperture, with_id) = (with_aperture?, with_id?);
        let mut table = Self { aperture_um2: with_aperture.map(|_| Vec::new()), ..Self::default() };
        let mut lines_of_ids = BTreeMap::new();
        for (line, text) in lines {
            if table.at.len() == MAX_ROWS {
                return Err(ImportError::TooMany { line });
            }
            let fields = split(text);
            let value = |k: usize| fields.get(columns[k]).map_or("", String::as_str);
            let at = DVec2::new(number(line, COLUMNS[0], value(0))?, number(line, COLUMNS[1], value(1))?);
            table.cone_type.push(cone_type(line, value(2), type_unknown)?);
            let more = |k: usize| fields.get(k).map_or("", String::as_str);
            if let (Some(k), Some(apertures)) = (with_aperture, &mut table.aperture_um2) {
                let diameter_um = diameter(line, more(k))?;
                apertures.push(FRAC_PI_4 * diameter_um * diameter_um);
            }
            let id = with_id.map_or(Ok(table.at.len() as u64), |k| whole(line, more(k)))?;
            if let Some(other) = lines_of_ids.insert(id, line) {
                return Err(ImportError::RepeatedId { line, other, id });
            }
            table.id.push(id);
            if !field.density.is_retina(at) {
                return Err(ImportError::OutsideRetina { line, x_um: at.x, y_um: at.y });
            }
            table.line.push(line);
            table.at.push(quantized(at));
        }
        if table.at.is_empty() { Err(ImportError::Empty) } else { Ok(table) }
    }
}

/// Where the columns are.
fn columns(line: usize, header: &str) -> Result<[usize; 3], ImportError> {
    let mut found = [0; 3];
    for (place, column) in found.iter_mut().zip(COLUMNS) {
        let missing = || ImportError::MissingColumn { line, column, header: excerpt(header) };
        *place = column_at(line, header, column)?.ok_or_else(missing)?;
    }
    Ok(found)
}

/// Where a column is, if it is there.
fn column_at(line: usize, header: &str, column: &'static str) -> Result<Option<usize>, ImportError> {
    let names = split(header);
    let mut at = names.iter().enumerate().filter(|(_, name)| name.eq_ignore_ascii_case(column));
    let found = at.next().map(|(k, _)| k);
    if at.next().is_some() { Err(ImportError::RepeatedColumn { line, column }) } else { Ok(found) }
}

/// The values of a line: between commas that are outside of double quotes, without quotes and blanks round them.
fn split(text: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut quoted = false;
    for c in text.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            other => {
                if let Some(last) = fields.last_mut() {
                    last.push(other);
                }
            }
        }
    }
    fields.iter().map(|field| field.trim().to_owned()).collect()
}

/// The first 80 characters, for messages.
fn excerpt(text: &str) -> String {
    text.chars().take(80).collect()
}

fn number(line: usize, column: &'static str, text: &str) -> Result<f64, ImportError> {
    let wrong = || ImportError::Value { line, column, value: excerpt(text), allowed: "a finite number, µm" };
    text.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(wrong)
}

/// A diameter of an aperture, µm.
fn diameter(line: usize, text: &str) -> Result<f64, ImportError> {
    let column = MORE_COLUMNS[0];
    let wrong =
        || ImportError::Value { line, column, value: excerpt(text), allowed: "a diameter of 0.5 to 30 µm" };
    text.parse().ok().filter(|diameter_um| (0.5..=30.0).contains(diameter_um)).ok_or_else(wrong)
}

fn whole(line: usize, text: &str) -> Result<u64, ImportError> {
    let (column, allowed) = (MORE_COLUMNS[1], "a whole number of 0 or more");
    text.parse().map_err(|_| ImportError::Value { line, column, value: excerpt(text), allowed })
}

fn cone_type(line: usize, text: &str, unknown: Option<ConeType>) -> Result<ConeType, ImportError> {
    if UNKNOWN.iter().any(|name| name.eq_ignore_ascii_case(text)) {
        return unknown.ok_or_else(|| ImportError::UnknownType { line, value: excerpt(text) });
    }
    match text {
        "L" | "l" | "0" => Ok(ConeType::L),
        "M" | "m" | "1" => Ok(ConeType::M),
        "S" | "s" | "2" => Ok(ConeType::S),
        _ => Err(ImportError::Value {
            line,
            column: COLUMNS[2],
            value: excerpt(text),
            allowed: "L, M or S, or 0, 1 or 2",
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{RetinaParams, import};
    use super::*;

    #[test]
    fn tables_are_read_as_people_write_them() {
        let text = "\u{feff}# measured\r\n\r\nName, TYPE ,\"Y_um\",x_UM\r\n\"a,b\",m,1.5,-2\r\n# more\r\nc,2,-3e0,\"4\"\r\nd,l,+9,9\r\n";
        let params = RetinaParams::default();
        let retina = import(text, &params, None).unwrap();
        let mut rows: Vec<usize> = (0..3).collect();
        rows.sort_unstable_by_key(|&i| retina.id[i]);
        let found: Vec<(DVec2, ConeType)> =
            rows.iter().map(|&i| (retina.center(i), retina.cone_type[i])).collect();
        let want = [(-2.0, 1.5, ConeType::M), (4.0, -3.0, ConeType::S), (9.0, 9.0, ConeType::L)];
        assert_eq!(found, want.map(|(x, y, t)| (DVec2::new(x, y), t)));
        assert_eq!(retina, import(text, &params, None).unwrap());
        let other = import(text, &RetinaParams { seed: 2, ..params }, None).unwrap();
        assert_ne!(other.pointing, retina.pointing);
    }

    #[test]
    fn errors_name_line_column_and_value() {
        let message = |text: &str| import(text, &RetinaParams::default(), None).unwrap_err().to_string();
        let head = "x_um,y_um,type\n";
        for (text, words) in [
            (String::new(), vec!["no cone", "x_um"]),
            (head.to_owned(), vec!["no cone"]),
            ("#c\nx,y_um,type\n1,2,L".to_owned(), vec!["line 2", "\"x_um\"", "x,y_um,type"]),
            ("x_um,y_um,type,X_UM\n".to_owned(), vec!["line 1", "\"x_um\"", "more than once"]),
            (format!("{head}1,2,L\n1,two,L"), vec!["line 3", "\"y_um\"", "\"two\"", "finite number"]),
            (format!("{head}NaN,2,L"), vec!["line 2", "\"x_um\"", "\"NaN\""]),
            (format!("{head}1,inf,L"), vec!["line 2", "\"y_um\"", "\"inf\""]),
            (
                format!("{head}1,2"),
                vec!["line 2", "\"type\"", "\"\"", "L, M or S", "retina.mosaic.type_unknown"],
            ),
            (format!("{head}1,2,U"), vec!["line 2", "\"type\"", "\"U\"", "retina.mosaic.type_unknown"]),
            ("id,x_um,y_um,type\n1,1,2,L\n1,9,9,L".to_owned(), vec!["line 3", "\"id\"", "line 2"]),
            ("id,x_um,y_um,type\na,1,2,L".to_owned(), vec!["line 2", "\"id\"", "\"a\"", "whole number"]),
            (
                "x_um,y_um,type,aperture_um\n1,2,L,0".to_owned(),
                vec!["line 2", "\"aperture_um\"", "\"0\"", "0.5 to 30 µm"],
            ),
            (format!("{head}1,2,3"), vec!["\"type\"", "\"3\""]),
            (format!("{head}26000,0,L"), vec!["line 2", "(26000, 0)", "outside the retina", "ora"]),
            (format!("{head}1,2,L\n9,9,L\n1.1,2.1,M"), vec!["line 4", "0.141", "line 2", "1 µm"]),
        ] {
            let found = message(&text);
            assert!(words.iter().all(|w| found.contains(w)), "{text:?}: {found}");
        }
        let params = RetinaParams { s_repulsion: 9.0, ..RetinaParams::default() };
        assert!(matches!(import(head, &params, None), Err(ImportError::Params(_))));
        let long = head.to_owned() + &"1,2,L\n".repeat(MAX_ROWS + 1);
        assert_eq!(
            import(&long, &RetinaParams::default(), None),
            Err(ImportError::TooMany { line: MAX_ROWS + 2 })
        );
    }
}
