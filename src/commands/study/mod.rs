//! `study`: what the model does and what it costs, measured here and now: tables (CSV), charts (PNG) and one page (index.html) a topic.

mod clock;
mod error_time;
mod figures;
mod optics;
mod page;
mod prediction;
mod retina;
pub mod scene;
mod stability;

use super::Context;
use crate::cli_study::{StudyArgs, StudyTopic};
use crate::failure::Failure;
use crate::progress::Progress;
use page::Page;

/// What every topic is told.
pub struct Task {
    /// Seconds instead of minutes.
    pub quick: bool,
    progress: Progress,
}

impl Task {
    /// Says what is being done.
    pub fn say(&mut self, text: &str) {
        self.progress.say(text);
    }

    /// One of two sizes.
    pub fn pick<T>(&self, full: T, quick: T) -> T {
        if self.quick { quick } else { full }
    }
}

/// Runs the command.
pub fn run(context: &Context, args: &StudyArgs) -> Result<(), Failure> {
    let takes_spec = matches!(args.topic, StudyTopic::ErrorVsTime | StudyTopic::Prediction);
    if !takes_spec && (args.spec.is_some() || !args.set.is_empty()) {
        return Err(Failure::usage("--spec and --set: allowed with error-vs-time and prediction"));
    }
    if !matches!(args.topic, StudyTopic::ErrorVsTime) && !args.scene.is_empty() {
        return Err(Failure::usage("--scene: allowed with error-vs-time"));
    }
    std::fs::create_dir_all(&args.out).map_err(|e| Failure::file("make", &args.out, &e))?;
    let mut task = Task { quick: args.quick, progress: Progress::new(context.json) };
    let mut page = Page::default();
    let mut verdict = Ok(());
    let outcome = match args.topic {
        StudyTopic::Optics => optics::study(&mut task, &mut page),
        StudyTopic::Figures => figures::study(&mut task, &mut page),
        StudyTopic::Retina => retina::study(&mut task, &mut page),
        StudyTopic::ErrorVsTime => error_time::study(&mut task, args, &mut page),
        StudyTopic::Prediction => prediction::study(&mut task, args, &mut page),
        StudyTopic::Stability => {
            let (failed, all) = stability::study(&mut task, &mut page);
            if failed > 0 {
                verdict = Err(Failure::failed(format!("stability: {failed} of {all} cases failed")));
            }
            Ok(())
        }
    };
    task.progress.finish();
    outcome?;
    page.write(&args.out)?;
    page.tell(context, &args.out)?;
    verdict
}
