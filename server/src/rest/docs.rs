//! The interface's description, as OpenAPI and as a page for people made from it.

use axum::response::{Html, IntoResponse as _, Response};
use http::header;
use photoneye_proto::OPENAPI_JSON;

pub(super) async fn openapi() -> Response {
    ([(header::CONTENT_TYPE, "application/json")], OPENAPI_JSON).into_response()
}

pub(super) async fn page() -> Html<&'static str> {
    Html(include_str!("docs.html"))
}
