//! What a study leaves behind: a page of text, tables and pictures; every table a CSV file, every picture a PNG file beside it.

use std::fmt::Write as _;
use std::path::Path;

use photoneye_eye::picture::RgbImage;
use serde_json::{Value, json};

use super::super::Context;
use crate::failure::Failure;
use crate::output;
use crate::result_folder::write_file;

/// A value of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A number, written in full into CSV and JSON, with four figures for people.
    Number(f64),
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        Self::Number(value)
    }
}

impl From<usize> for Cell {
    fn from(value: usize) -> Self {
        Self::Number(value as f64)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// A row of values that become cells.
#[macro_export]
macro_rules! row {
    ($($value:expr),* $(,)?) => { vec![$($crate::commands::study::page::Cell::from($value)),*] };
}

/// Rows under named columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Name of the CSV file, without ending.
    pub name: String,
    /// Above the table.
    pub title: String,
    /// Names with units.
    pub columns: Vec<String>,
    /// As many cells as columns.
    pub rows: Vec<Vec<Cell>>,
    /// Only in the CSV file: too long for people.
    pub long: bool,
}

impl Table {
    /// A table without rows.
    pub fn new(name: &str, title: &str, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|c| (*c).to_owned()).collect();
        Self { name: name.into(), title: title.into(), columns, ..Self::default() }
    }

    /// The same, only as a file.
    pub fn long(self) -> Self {
        Self { long: true, ..self }
    }

    /// Adds a row.
    pub fn push(&mut self, row: Vec<Cell>) {
        self.rows.push(row);
    }

    fn csv(&self) -> String {
        let quoted = |text: &str| {
            if text.contains([',', '"', '\n']) {
                format!("\"{}\"", text.replace('"', "\"\""))
            } else {
                text.to_owned()
            }
        };
        let line = |cells: Vec<String>| cells.join(",") + "\n";
        let mut out = line(self.columns.iter().map(|c| quoted(c)).collect());
        for row in &self.rows {
            out += &line(
                row.iter()
                    .map(|cell| match cell {
                        Cell::Text(text) => quoted(text),
                        Cell::Number(value) => value.to_string(),
                    })
                    .collect(),
            );
        }
        out
    }

    fn html(&self) -> String {
        let mut out = format!("<h3>{}</h3>\n<table><tr>", escaped(&self.title));
        let _ = self.columns.iter().try_for_each(|c| write!(out, "<th>{}</th>", escaped(c)));
        for row in &self.rows {
            out += "</tr>\n<tr>";
            for cell in row {
                let class = if matches!(cell, Cell::Number(_)) { " class=n" } else { "" };
                let _ = write!(out, "<td{class}>{}</td>", escaped(&shown(cell)));
            }
        }
        out + &format!("</tr></table>\n<p><a href=\"{0}.csv\">{0}.csv</a></p>\n", self.name)
    }

    fn text(&self) -> String {
        let cells: Vec<Vec<String>> = self.rows.iter().map(|row| row.iter().map(shown).collect()).collect();
        let width = |k: usize| {
            let longest = cells.iter().filter_map(|row| row.get(k)).map(|c| c.chars().count()).max();
            longest.unwrap_or(0).max(self.columns[k].chars().count())
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let line = |cells: &[String]| {
            let padded = cells.iter().zip(&widths).map(|(c, w)| format!("{c:<w$}"));
            padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
        };
        let mut out = format!("{}\n  {}", self.title, line(&self.columns));
        for row in &cells {
            let _ = write!(out, "\n  {}", line(row));
        }
        out
    }

    fn json(&self) -> Value {
        let object = |row: &Vec<Cell>| {
            let value = |cell: &Cell| match cell {
                Cell::Text(text) => json!(text),
                Cell::Number(value) => json!(value),
            };
            Value::Object(self.columns.iter().cloned().zip(row.iter().map(value)).collect())
        };
        Value::Array(self.rows.iter().map(object).collect())
    }
}

fn shown(cell: &Cell) -> String {
    match cell {
        Cell::Text(text) => text.clone(),
        Cell::Number(value) if value.is_nan() => "-".into(),
        Cell::Number(value) => figures(*value),
    }
}

/// A number with four figures.
pub fn figures(value: f64) -> String {
    let size = value.abs();
    if size.total_cmp(&0.0).is_eq() {
        return "0".into();
    }
    if !(1e-3..1e7).contains(&size) {
        return format!("{value:.3e}");
    }
    if value.fract() == 0.0 || size >= 1e4 {
        return crate::chart::number(value, 0.0);
    }
    format!("{:.*}", (3.0 - size.log10().floor()).max(0.0) as usize, value)
}

enum Block {
    Heading(String),
    Text(String),
    Table(Table),
    Picture { name: String, caption: String, image: RgbImage },
}

/// The page of a study.
#[derive(Default)]
pub struct Page {
    title: String,
    blocks: Vec<Block>,
}

impl Page {
    /// Sets the title and a first paragraph.
    pub fn begin(&mut self, title: &str, text: &str) {
        title.clone_into(&mut self.title);
        self.text(text);
    }

    /// A section.
    pub fn heading(&mut self, text: &str) {
        self.blocks.push(Block::Heading(text.into()));
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) {
        self.blocks.push(Block::Text(text.into()));
    }

    /// A table.
    pub fn table(&mut self, table: Table) {
        self.blocks.push(Block::Table(table));
    }

    /// A picture; `name` without ending.
    pub fn picture(&mut self, name: &str, caption: &str, image: RgbImage) {
        self.blocks.push(Block::Picture { name: name.into(), caption: caption.into(), image });
    }

    fn html(&self) -> String {
        let title = escaped(&self.title);
        let mut out = format!(
            "<!doctype html>\n<html lang=en><meta charset=utf-8><title>{title}</title>\n<style>\
             body{{font:15px/1.45 sans-serif;max-width:1250px;margin:2em auto;padding:0 1em;color:#222}}\
             table{{border-collapse:collapse;font-size:13px}}td,th{{border:1px solid #ccc;padding:3px 8px;text-align:left}}\
             th{{background:#f2f2f2}}td.n{{text-align:right;font-variant-numeric:tabular-nums}}\
             img{{max-width:100%;border:1px solid #ddd}}figcaption{{color:#444}}figure{{margin:1.5em 0}}</style>\n\
             <h1>{title}</h1>\n<p>photoneye {}</p>\n",
            env!("CARGO_PKG_VERSION")
        );
        for block in &self.blocks {
            let part = match block {
                Block::Heading(text) => format!("<h2>{}</h2>\n", escaped(text)),
                Block::Text(text) => format!("<p>{}</p>\n", escaped(text)),
                Block::Table(table) if table.long => {
                    format!("<p>{}: <a href=\"{1}.csv\">{1}.csv</a></p>\n", escaped(&table.title), table.name)
                }
                Block::Table(table) => table.html(),
                Block::Picture { name, caption, .. } => format!(
                    "<figure><img src=\"{name}.png\" alt=\"{0}\"><figcaption>{0}</figcaption></figure>\n",
                    escaped(caption)
                ),
            };
            out += &part;
        }
        out + "</html>\n"
    }

    /// Writes index.html, the pictures and the tables into a folder.
    ///
    /// # Errors
    /// When the place cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), Failure> {
        for block in &self.blocks {
            match block {
                Block::Heading(_) | Block::Text(_) => {}
                Block::Table(table) => {
                    write_file(&folder.join(format!("{}.csv", table.name)), table.csv().as_bytes())?;
                }
                Block::Picture { name, image, .. } => {
                    let bytes = image.png().map_err(Failure::failed)?;
                    write_file(&folder.join(format!("{name}.png")), &bytes)?;
                }
            }
        }
        write_file(&folder.join("index.html"), self.html().as_bytes())
    }

    /// Prints the tables, or everything of them as JSON.
    ///
    /// # Errors
    /// When standard output cannot be written.
    pub fn tell(&self, context: &Context, folder: &Path) -> Result<(), Failure> {
        let tables = || {
            self.blocks.iter().filter_map(|block| match block {
                Block::Table(table) if !table.long => Some(table),
                _ => None,
            })
        };
        let page = folder.join("index.html");
        if context.json {
            let tables: serde_json::Map<String, Value> =
                tables().map(|t| (t.name.clone(), t.json())).collect();
            return output::json(&json!({"title": self.title, "page": page, "tables": tables}));
        }
        for table in tables() {
            output::line(format_args!("{}\n", table.text()))?;
        }
        output::line(format_args!("{}", page.display()))
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_figures() {
        for (value, text) in [
            (0.0, "0"),
            (3.0, "3"),
            (0.012345, "0.01235"),
            (1.5, "1.500"),
            (123456.7, "123,457"),
            (1.2344e-7, "1.234e-7"),
            (-2e9, "-2.000e9"),
        ] {
            assert_eq!(figures(value), text);
        }
        assert_eq!(figures(f64::NAN), "NaN");
    }

    #[test]
    fn a_table_is_the_same_everywhere() {
        let mut table = Table::new("t", "T <1>", &["a, b", "c"]);
        table.push(row!["x \"y\"", 1.25]);
        assert_eq!(table.csv(), "\"a, b\",c\n\"x \"\"y\"\"\",1.25\n");
        assert!(table.html().contains("T &lt;1&gt;") && table.html().contains("<td class=n>1.250</td>"));
        assert_eq!(table.text(), "T <1>\n  a, b   c\n  x \"y\"  1.250");
        assert_eq!(table.json()[0]["c"], 1.25);
    }
}
