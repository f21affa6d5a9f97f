//! The gRPC door.

mod blobs;
mod experiments;
mod workers;

use std::sync::Arc;

use axum::Router;
use photoneye_proto::FILE_DESCRIPTOR_SET;
use photoneye_proto::v1::blobs_server::BlobsServer;
use photoneye_proto::v1::experiments_server::ExperimentsServer;
use photoneye_proto::v1::workers_server::WorkersServer;
use tonic::Status;
use tonic::service::Routes;

use crate::access::Caller;
use crate::service::Service;

/// Largest message, bytes.
pub const MAX_MESSAGE: usize = 8 << 20;

/// The request came over the in-memory connection, from this process.
#[derive(Clone, Copy, Debug)]
pub struct Local;

/// All gRPC services as routes.
///
/// # Errors
/// When the descriptors of the schema cannot be read.
pub async fn routes(service: &Arc<Service>) -> Result<Router, tonic_reflection::server::Error> {
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let (health, health_service) = tonic_health::server::health_reporter();
    for name in ["photoneye.v1.Experiments", "photoneye.v1.Blobs", "photoneye.v1.Workers"] {
        health.set_service_status(name, tonic_health::ServingStatus::Serving).await;
    }
    let experiments = experiments::Door(Arc::clone(service));
    let mut routes = Routes::builder();
    routes
        .add_service(ExperimentsServer::new(experiments).max_decoding_message_size(MAX_MESSAGE))
        .add_service(
            BlobsServer::new(blobs::Door(Arc::clone(service))).max_decoding_message_size(MAX_MESSAGE),
        )
        .add_service(
            WorkersServer::new(workers::Door(Arc::clone(service))).max_decoding_message_size(MAX_MESSAGE),
        )
        .add_service(health_service)
        .add_service(reflection().build_v1()?)
        .add_service(reflection().build_v1alpha()?);
    Ok(routes.routes().into_axum_router().reset_fallback())
}

/// Who asks; the guard in front of the door has found out.
fn caller<T>(request: &tonic::Request<T>) -> Result<Caller, Status> {
    let caller = request.extensions().get::<Caller>().cloned();
    caller.ok_or_else(|| Status::unauthenticated("nobody says who asks"))
}

/// A field without which the request means nothing.
fn needed<T>(name: &str, value: Option<T>) -> Result<T, Status> {
    value.ok_or_else(|| Status::invalid_argument(format!("{name}: is missing")))
}
