//! `render`: draws the pictures of a result folder again, and its profile.

use super::Context;
use crate::cli::RenderArgs;
use crate::failure::Failure;
use crate::{output, pictures, profile};

/// Runs the command.
pub fn run(context: &Context, args: &RenderArgs) -> Result<(), Failure> {
    let drawn = pictures::draw(&args.dir, args.pictures)?;
    let folder = args.dir.join("frames");
    let profile = if args.profile { Some(profile::write(&args.dir)?) } else { None };
    if context.json {
        return output::json(&serde_json::json!({"frames": folder, "pictures": drawn, "profile": profile}));
    }
    output::line(format_args!("{drawn} picture(s) in {}", folder.display()))?;
    profile.map_or(Ok(()), |said| output::line(format_args!("{said}")))
}
