//! `serve`: REST and gRPC on one port, with workers in the same process.

use std::net::SocketAddr;

use super::{Context, interrupted};
use crate::cli::ServeArgs;
use crate::failure::Failure;
use crate::output;
use crate::service::{Embedded, Listen};
use crate::settings::DEFAULT_LISTEN;

/// Runs the command until it is interrupted.
pub async fn run(context: Context, args: ServeArgs) -> Result<(), Failure> {
    let settings = context.settings;
    let text = args.listen.or(settings.listen.clone()).unwrap_or_else(|| DEFAULT_LISTEN.into());
    let address: SocketAddr = text.parse().map_err(|_| {
        Failure::usage(format!("`{text}` is not an address and port such as {DEFAULT_LISTEN}"))
    })?;
    let insecure = args.insecure;
    if !address.ip().is_loopback() && !insecure {
        return Err(Failure::usage(format!(
            "{address} can be reached by others and there is no access control: give --insecure if that is meant"
        )));
    }
    let data = settings.data(args.data)?;
    let stop = interrupted();
    let listen = Listen { address, insecure };
    let server = Embedded::start(&data, Some(listen), settings.workers(args.workers)).await?;
    let address = server.address;
    if context.json {
        output::json_line(&serde_json::json!({"listening": format!("http://{address}"), "data": data}))?;
    } else {
        output::line(format_args!("listening on http://{address}, data in {}", data.display()))?;
    }
    stop.await;
    server.stop(true).await;
    Ok(())
}
