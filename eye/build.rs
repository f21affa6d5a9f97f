//! Embeds the data files, so that one binary needs nothing beside it: writes a table of (folder, name, text).
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

const FOLDERS: [(&str, &str); 3] = [("eyes", "json"), ("displays", "json"), ("spectra", "csv")];

fn main() -> io::Result<()> {
    let data = Path::new(&env::var("CARGO_MANIFEST_DIR").map_err(io::Error::other)?).join("../data");
    let mut table = String::from(
        "/// (folder, name without ending, text), sorted.\npub const FILES: &[(&str, &str, &str)] = &[\n",
    );
    for (folder, ending) in FOLDERS {
        let path = data.join(folder);
        println!("cargo::rerun-if-changed={}", path.display());
        for file in sorted_files(&path, ending)? {
            let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let file = file.canonicalize()?;
            println!("cargo::rerun-if-changed={}", file.display());
            writeln!(table, "    ({folder:?}, {name:?}, include_str!({:?})),", file.display().to_string())
                .map_err(io::Error::other)?;
        }
    }
    table.push_str("];\n");
    let out = PathBuf::from(env::var("OUT_DIR").map_err(io::Error::other)?);
    fs::write(out.join("catalog.rs"), table)
}

fn sorted_files(folder: &Path, ending: &str) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|e| e == ending) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}
