//! Where traces go: by OTLP over plain HTTP to the collector that the standard variables of OpenTelemetry name.

use std::future::Future;
use std::pin::Pin;
use std::time::Duration;

use http_body_util::{BodyExt, Full, Limited};
use hyper::body::Bytes;
use hyper::header::{HOST, HeaderValue};
use hyper::{Request, Response};
use hyper_util::rt::TokioIo;
use opentelemetry_http::{HttpClient, HttpError};
use opentelemetry_otlp::{SpanExporter, WithExportConfig, WithHttpConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::SdkTracerProvider;

/// Bytes of an answer that are read at most.
const ANSWER_MAX: usize = 65_536;
/// An export that takes longer has failed.
const EXPORT_MAX: Duration = Duration::from_secs(10);

/// What exports traces, if a collector is named: `OTEL_EXPORTER_OTLP_TRACES_ENDPOINT` or `OTEL_EXPORTER_OTLP_ENDPOINT`.
///
/// # Errors
/// What they say cannot be used, for people.
pub(crate) fn provider() -> Result<Option<SdkTracerProvider>, String> {
    let set = |name| std::env::var(name).is_ok_and(|value| !value.is_empty());
    let is_disabled =
        std::env::var("OTEL_SDK_DISABLED").is_ok_and(|value| value.eq_ignore_ascii_case("true"));
    if is_disabled || !(set("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT") || set("OTEL_EXPORTER_OTLP_ENDPOINT")) {
        return Ok(None);
    }
    exporting_to(None).map(Some)
}

/// What exports to a collector; without an address, as the variables say.
///
/// # Errors
/// As [`provider`].
pub(super) fn exporting_to(endpoint: Option<&str>) -> Result<SdkTracerProvider, String> {
    let client = Client::new().map_err(|error| format!("cannot export traces: {error}"))?;
    let builder = SpanExporter::builder().with_http().with_http_client(client);
    let builder = match endpoint {
        Some(endpoint) => builder.with_endpoint(endpoint),
        None => builder,
    };
    let exporter = builder.build().map_err(|error| format!("cannot export traces: {error}"))?;
    let resource = match std::env::var_os("OTEL_SERVICE_NAME") {
        Some(_) => Resource::builder().build(),
        None => Resource::builder().with_service_name("downbeat").build(),
    };
    Ok(SdkTracerProvider::builder().with_batch_exporter(exporter).with_resource(resource).build())
}

/// One request a connection, made on the exporter's own thread, which waits for it.
#[derive(Debug)]
struct Client(tokio::runtime::Runtime);

impl Client {
    fn new() -> std::io::Result<Self> {
        Ok(Self(tokio::runtime::Builder::new_current_thread().enable_all().build()?))
    }

    fn send(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        self.0.block_on(async { tokio::time::timeout(EXPORT_MAX, exchange(request)).await? })
    }
}

impl HttpClient for Client {
    fn send_bytes<'a, 'b>(
        &'a self,
        request: Request<Bytes>,
    ) -> Pin<Box<dyn Future<Output = Result<Response<Bytes>, HttpError>> + Send + 'b>>
    where
        'a: 'b,
        Self: 'b,
    {
        Box::pin(std::future::ready(self.send(request)))
    }
}

async fn exchange(request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
    let (mut head, body) = request.into_parts();
    if head.uri.scheme_str() != Some("http") {
        return Err(format!("{}: expected an address that begins with http://", head.uri).into());
    }
    let authority = head.uri.authority().ok_or("expected a host in the address")?;
    let host = authority.host().trim_start_matches('[').trim_end_matches(']');
    let stream = tokio::net::TcpStream::connect((host, authority.port_u16().unwrap_or(80))).await?;
    head.headers.insert(HOST, HeaderValue::from_str(authority.as_str())?);
    let path = head.uri.path_and_query().map_or("/", |path| path.as_str());
    head.uri = path.parse()?;
    let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await?;
    let asked = sender.send_request(Request::from_parts(head, Full::new(body)));
    let mut connection = std::pin::pin!(connection);
    let mut asked = std::pin::pin!(asked);
    let answer = tokio::select! {
        answer = &mut asked => answer?,
        ended = &mut connection => {
            ended?;
            return Err("the collector closed the connection".into());
        }
    };
    let (head, body) = answer.into_parts();
    let mut read = std::pin::pin!(Limited::new(body, ANSWER_MAX).collect());
    let body = tokio::select! {
        body = &mut read => body?,
        ended = &mut connection => {
            ended?;
            read.await?
        }
    };
    Ok(Response::from_parts(head, body.to_bytes()))
}
