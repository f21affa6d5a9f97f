//! How far a job is: a bar on a terminal, a line a change otherwise.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use photoneye_proto::v1;

use crate::output;

/// Least time between two plain lines about the same thing.
const PAUSE: Duration = Duration::from_secs(2);

/// Shows the progress of one job.
pub struct Progress {
    bar: Option<ProgressBar>,
    last: Option<(Instant, String)>,
    quiet: bool,
}

impl Progress {
    /// A bar on a terminal, lines otherwise, nothing when `quiet`.
    pub fn new(quiet: bool) -> Self {
        let style = ProgressStyle::with_template("{elapsed:>4} [{bar:30}] {msg}");
        let bar = (!quiet && output::is_terminal()).then(|| {
            let bar = ProgressBar::with_draw_target(Some(100), ProgressDrawTarget::stderr());
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        Self { bar, last: None, quiet }
    }

    /// Says what is being done outside the job.
    pub fn say(&mut self, text: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(text.to_owned()),
            None if self.quiet => {}
            None => output::note(format_args!("{text}")),
        }
    }

    /// Shows a job's progress.
    pub fn show(&mut self, job: &v1::Job) {
        let Some(progress) = &job.progress else {
            return;
        };
        let text = describe(progress);
        if let Some(bar) = &self.bar {
            let total = progress.builds_total() + progress.shards_total();
            bar.set_length(u64::from(total.max(1)));
            bar.set_position(u64::from(progress.builds_done() + progress.shards_done()));
            bar.set_message(text);
            return;
        }
        let soon = |(at, _): &(Instant, String)| at.elapsed() < PAUSE;
        let same = |(_, before): &(Instant, String)| *before == text;
        if self.quiet || self.last.as_ref().is_some_and(|last| soon(last) || same(last)) {
            return;
        }
        output::note(format_args!("{text}"));
        self.last = Some((Instant::now(), text));
    }

    /// Takes the bar away.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

fn describe(progress: &v1::Progress) -> String {
    let mut text = format!(
        "optics and retina {}/{}, counting {}/{}",
        progress.builds_done(),
        progress.builds_total(),
        progress.shards_done(),
        progress.shards_total()
    );
    if !progress.stage().is_empty() {
        text.push_str(" · ");
        text.push_str(progress.stage());
    }
    text
}
