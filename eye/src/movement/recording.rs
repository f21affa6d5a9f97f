//! The table of a recorded gaze: comma-separated values with a header line; columns are read by name and
//! unit.

/// A column of the file: its name, and the factor from its unit to that of the schema.
type Column = (&'static str, f64);

/// Names of the times, in seconds or milliseconds.
const TIMES: [Column; 2] = [("t_s", 1.0), ("t_ms", 1e-3)];
/// Names of the places to the right, in minutes of arc or degrees.
const RIGHT: [Column; 2] = [("x_arcmin", 1.0), ("x_deg", 60.0)];
/// Names of the places up.
const UP: [Column; 2] = [("y_arcmin", 1.0), ("y_deg", 60.0)];

/// A recorded gaze in the units of the schema, as many of each.
#[derive(Debug, Default, PartialEq)]
pub struct RecordedGaze {
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Places to the right, minutes of arc.
    pub x_arcmin: Vec<f64>,
    /// Places up, minutes of arc.
    pub y_arcmin: Vec<f64>,
}

/// Reads a table's text. Commas, semicolons or tabs separate cells; lines that start with # are comments; a
/// byte order mark and carriage returns are ignored.
///
/// # Errors
/// The line and what is wrong: a header with other or missing columns, or a cell that is no number.
pub fn read(text: &str) -> Result<RecordedGaze, String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines =
        (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));

    // Find the columns in the header.
    let (number, header) = lines.next().ok_or("is empty; expected a header line and a line per sample")?;
    let separator = [';', '\t'].into_iter().find(|mark| header.contains(*mark)).unwrap_or(',');
    let names: Vec<&str> = header.split(separator).map(|name| name.trim().trim_matches('"')).collect();
    let columns = [TIMES, RIGHT, UP].map(|allowed| find(&names, &allowed));
    let [time, right, up] = columns;
    let ((Some(time), Some(right), Some(up)), 3) = ((time?, right?, up?), names.len()) else {
        return Err(format!(
            "line {number}: the header is `{}`; expected three columns: t_s or t_ms, x_arcmin or x_deg, y_arcmin or \
             y_deg",
            header.trim()
        ));
    };

    // Read the samples.
    let mut gaze = RecordedGaze::default();
    for (number, line) in lines {
        let cells: Vec<Option<f64>> = line.split(separator).map(|cell| cell.trim().parse().ok()).collect();
        if cells.len() != names.len() || cells.contains(&None) {
            return Err(format!(
                "line {number}: `{}`; expected three numbers, {}",
                line.trim(),
                header.trim()
            ));
        }
        let value = |(column, factor): (usize, f64)| factor * cells[column].unwrap_or(f64::NAN);
        gaze.t_s.push(value(time));
        gaze.x_arcmin.push(value(right));
        gaze.y_arcmin.push(value(up));
    }
    Ok(gaze)
}

/// The place of the one column with an allowed name, and its factor; `None` when there is none.
fn find(names: &[&str], allowed: &[Column]) -> Result<Option<(usize, f64)>, String> {
    let found: Vec<(usize, f64)> = allowed
        .iter()
        .flat_map(|(name, factor)| {
            names.iter().enumerate().filter(move |(_, n)| *n == name).map(|(place, _)| (place, *factor))
        })
        .collect();
    match found[..] {
        [] => Ok(None),
        [one] => Ok(Some(one)),
        _ => {
            let names: Vec<&str> = allowed.iter().map(|(name, _)| *name).collect();
            Err(format!("the header has more than one of {}", names.join(", ")))
        }
    }
}

impl RecordedGaze {
    /// Time (s) and places to the right and up (minutes of arc) of each sample.
    pub fn samples(&self) -> Vec<[f64; 3]> {
        let places = self.x_arcmin.iter().zip(&self.y_arcmin);
        self.t_s.iter().zip(places).map(|(t, (x, y))| [t + 0.0, x + 0.0, y + 0.0]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_read_by_name_and_unit() {
        let plain = read("t_s,x_arcmin,y_arcmin\n0,5,2\n0.5,6,3\n").unwrap();
        assert_eq!(plain.x_arcmin, [5.0, 6.0]);
        for same in [
            "t_s,y_arcmin,x_arcmin\n0,2,5\n0.5,3,6\n",
            "\u{feff}t_ms;x_arcmin;y_arcmin\r\n0;5;2\r\n500;6;3\r\n",
            "# a comment\nx_deg\tt_s\ty_arcmin\n0.08333333333333333\t0\t2\n0.1\t0.5\t3\n",
        ] {
            let read = read(same).unwrap();
            assert_eq!(read.t_s, plain.t_s, "{same}");
            assert!(
                (read.x_arcmin[0] - 5.0).abs() < 1e-12 && (read.x_arcmin[1] - 6.0).abs() < 1e-12,
                "{same}"
            );
            assert_eq!(read.y_arcmin, plain.y_arcmin, "{same}");
        }
    }

    #[test]
    fn other_files_are_refused_by_line_and_name() {
        for (text, words) in [
            ("", "is empty"),
            ("0,5,2\n1,5,2\n", "t_s or t_ms"),
            ("t_s,x_px,y_px\n0,5,2\n", "x_arcmin or x_deg"),
            ("t_s,x_arcmin,y_arcmin,pupil_mm\n0,5,2,3\n", "expected three columns"),
            ("t_s,t_ms,x_deg,y_deg\n0,0,5,2\n", "more than one of t_s, t_ms"),
            ("t_s;x_deg;y_deg\n0;0,5;2\n", "line 2: `0;0,5;2`"),
            ("t_s,x_deg,y_deg\n0,5\n", "line 2"),
        ] {
            let why = read(text).unwrap_err();
            assert!(why.contains(words), "{why}");
        }
    }
}
