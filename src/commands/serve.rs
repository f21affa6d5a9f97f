//! `serve`: REST and gRPC on one port, with workers in the same process.

use std::net::SocketAddr;

use super::{Context, interrupted};
use crate::cli::ServeArgs;
use crate::failure::Failure;
use crate::output;
use crate::service::Embedded;
use crate::settings::DEFAULT_LISTEN;

/// Runs the command until it is interrupted.
pub async fn run(context: Context, args: ServeArgs) -> Result<(), Failure> {
    let settings = context.settings;
    let text = args.listen.or(settings.listen.clone()).unwrap_or_else(|| DEFAULT_LISTEN.into());
    let address: SocketAddr = text.parse().map_err(|_| {
        Failure::usage(format!("`{text}` is not an address and port such as {DEFAULT_LISTEN}"))
    })?;
    let data = settings.data(args.data)?;
    let mut options = photoneye_server::Options::new(&data);
    (options.listen, options.insecure, options.limits) = (address, args.insecure, settings.limits());
    options.store_max_bytes = settings.store_max(args.store_max)?;
    let of_file = settings.tls_cert.clone().zip(settings.tls_key.clone());
    options.tls = args.tls_cert.zip(args.tls_key).or(of_file);
    let scheme = if options.tls.is_some() { "https" } else { "http" };
    if !address.ip().is_loopback() && options.tls.is_none() {
        output::note(format_args!("keys and results travel unencrypted: see --tls-cert and --tls-key"));
    }
    let stop = interrupted();
    let server = Embedded::start(options, settings.workers(args.workers)).await?;
    let address = server.address;
    if context.json {
        output::json_line(&serde_json::json!({"listening": format!("{scheme}://{address}"), "data": data}))?;
    } else {
        output::line(format_args!("listening on {scheme}://{address}, data in {}", data.display()))?;
    }
    stop.await;
    server.stop(true).await;
    Ok(())
}
