//! What can be typed after `study`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// `study`.
#[derive(Debug, Args)]
pub struct StudyArgs {
    /// What to look into
    #[arg(value_enum)]
    pub topic: StudyTopic,
    /// Folder for index.html with its pictures, and a CSV file a table
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Smaller and coarser: seconds instead of minutes
    #[arg(long)]
    pub quick: bool,
    /// An experiment of your own instead of the built-in scenes (error-vs-time, prediction)
    #[arg(long, value_name = "FILE.json")]
    pub spec: Option<PathBuf>,
    /// Only built-in scenes with this in their names, one after the other (error-vs-time)
    #[arg(long, value_name = "NAME", conflicts_with = "spec")]
    pub scene: Vec<String>,
    /// Change a field of that experiment: eye.pupil_mm=5, accuracy.target=0.001
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub set: Vec<String>,
}

/// `calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// Data folder of the server [default: $XDG_DATA_HOME/photoneye, else ~/.local/share/photoneye]
    #[arg(long, env = "PHOTONEYE_DATA", value_name = "DIR")]
    pub data: Option<PathBuf>,
}

/// What can be looked into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StudyTopic {
    /// The eye's optics: rays, spots, point spreads, transfer, focus, colour; error against time of six ways to a point spread.
    Optics,
    /// The paper's Figures 12 to 16, large, with the cut-off and the letters that can be read.
    Figures,
    /// What a mosaic costs, from a thousand cones to the whole retina.
    Retina,
    /// Error of the mean per cone against CPU time, for each setting and engine.
    ErrorVsTime,
    /// What was foreseen against what it took: seconds, memory and errors of the example experiments and the built-in scenes.
    Prediction,
    /// Extreme and stiff cases, each with its figure and limit; fails when one does.
    Stability,
}
