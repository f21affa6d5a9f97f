//! The data files of `data/`, embedded at build time: eyes, displays and spectra by name.

include!(concat!(env!("OUT_DIR"), "/catalog.rs"));

/// The text of one data file; `None` when there is no such name in the folder.
pub fn text(folder: &str, name: &str) -> Option<&'static str> {
    FILES.iter().find(|(f, n, _)| *f == folder && *n == name).map(|(_, _, text)| *text)
}

/// The names in one folder (`eyes`, `displays`, `spectra`), sorted.
pub fn names(folder: &str) -> Vec<&'static str> {
    FILES.iter().filter(|(f, _, _)| *f == folder).map(|(_, name, _)| *name).collect()
}
