//! `render`: draws the pictures of a result folder again.

use super::Context;
use crate::cli::RenderArgs;
use crate::failure::Failure;
use crate::{output, pictures};

/// Runs the command.
pub fn run(context: &Context, args: &RenderArgs) -> Result<(), Failure> {
    let drawn = pictures::draw(&args.dir, args.pictures)?;
    let folder = args.dir.join("frames");
    if context.json {
        return output::json(&serde_json::json!({"frames": folder, "pictures": drawn}));
    }
    output::line(format_args!("{drawn} picture(s) in {}", folder.display()))
}
