//! Who may ask: the browser window that was opened with the token, on this machine, and no other site in it.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{COOKIE, HOST, HeaderName, HeaderValue, LOCATION, ORIGIN, SET_COOKIE};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::gate::Gate;
use super::routes::Refused;

/// What every answer says of itself.
const HEADERS: [(HeaderName, &str); 6] = [
    (HeaderName::from_static("x-content-type-options"), "nosniff"),
    (HeaderName::from_static("referrer-policy"), "no-referrer"),
    (HeaderName::from_static("cache-control"), "no-store"),
    (HeaderName::from_static("x-frame-options"), "DENY"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
];
const POLICY: HeaderName = HeaderName::from_static("content-security-policy");
/// What answers that are no page may do.
const NOTHING: HeaderValue = HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'");

/// Lets through what comes from the page itself.
///
/// The name that the browser asked for is checked, as another site's name may point here (DNS rebinding); then the page that a request
/// comes from; then the session's cookie, which only the token in the opening address gives.
pub(super) async fn guard(State(gate): State<Arc<Gate>>, request: Request, next: Next) -> Response {
    let mut answer =
        match admitted(&gate, request.headers(), request.method(), request.uri().path(), request.uri().query()) {
            Ok(Admitted::In) => next.run(request).await,
            Ok(Admitted::Opened) => {
                let cookie = format!("{}={}; HttpOnly; SameSite=Strict; Path=/", gate.cookie_name(), gate.session());
                (StatusCode::SEE_OTHER, [(LOCATION, "/".to_owned()), (SET_COOKIE, cookie)]).into_response()
            }
            Err(refused) => refused.into_response(),
        };
    let headers = answer.headers_mut();
    headers.extend(HEADERS.map(|(name, value)| (name, HeaderValue::from_static(value))));
    if !headers.contains_key(POLICY) {
        headers.insert(POLICY, NOTHING);
    }
    answer
}

#[derive(Debug, PartialEq, Eq)]
enum Admitted {
    In,
    /// By the token, for the first time.
    Opened,
}

fn admitted(
    gate: &Gate,
    headers: &HeaderMap,
    method: &Method,
    path: &str,
    query: Option<&str>,
) -> Result<Admitted, Refused> {
    let forbidden = |reason: &str| Refused::new(StatusCode::FORBIDDEN, reason);
    let text = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
    let hosts = gate.hosts();
    let host = text(HOST).filter(|host| hosts.iter().any(|known| known == host));
    let host = host.ok_or_else(|| forbidden("this server answers to 127.0.0.1 alone"))?;
    let origin = text(ORIGIN);
    if origin.is_some_and(|origin| origin != format!("http://{host}")) {
        return Err(forbidden("another site may not ask this server"));
    }
    // Browsers also say where what a page loads is asked from: a page of another port of this machine sends the cookie, too.
    let site = text(HeaderName::from_static("sec-fetch-site"));
    if site.is_some_and(|site| !["same-origin", "none"].contains(&site)) && path != "/" {
        return Err(forbidden("another site may not ask this server"));
    }
    // Browsers name the page that a request which changes something comes from.
    if method != Method::GET && origin.is_none() {
        return Err(forbidden("a request that changes something has to come from the page"));
    }
    if method == Method::GET && path == "/" && query == Some(&format!("token={}", gate.token())) {
        return Ok(Admitted::Opened);
    }
    let cookie = format!("{}={}", gate.cookie_name(), gate.session());
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    if cookies.flat_map(|value| value.split(';')).any(|one| one.trim() == cookie) {
        return Ok(Admitted::In);
    }
    Err(Refused::new(
        StatusCode::UNAUTHORIZED,
        "open the address that `belfry serve` has printed: it holds the token of this session",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(gate: &Gate, method: Method, path: &str, headers: &[(HeaderName, &str)]) -> Result<Admitted, StatusCode> {
        let headers =
            headers.iter().map(|(name, value)| (name.clone(), HeaderValue::from_str(value).unwrap())).collect();
        let (path, query) = path.split_once('?').map_or((path, None), |(path, query)| (path, Some(query)));
        admitted(gate, &headers, &method, path, query).map_err(|refused| refused.status())
    }

    #[test]
    fn only_the_window_that_was_opened_with_the_token_comes_in() {
        let gate = Gate::of(7300, "right", "session");
        let (host, cookie) = ((HOST, "127.0.0.1:7300"), (COOKIE, "other=1; belfry_7300=session"));
        let (get, post) = (Method::GET, Method::POST);
        let forbidden = Err(StatusCode::FORBIDDEN);
        let unknown = Err(StatusCode::UNAUTHORIZED);
        assert_eq!(asked(&gate, get.clone(), "/?token=right", std::slice::from_ref(&host)), Ok(Admitted::Opened));
        assert_eq!(asked(&gate, get.clone(), "/?token=wrong", std::slice::from_ref(&host)), unknown);
        assert_eq!(asked(&gate, get.clone(), "/data?token=right", std::slice::from_ref(&host)), unknown);
        assert_eq!(asked(&gate, get.clone(), "/data", &[host.clone(), cookie.clone()]), Ok(Admitted::In));
        assert_eq!(asked(&gate, get.clone(), "/data", &[host.clone(), (COOKIE, "belfry_7300=guess")]), unknown);
        // Another site whose name points here, and another site that sends a form or a script's request.
        assert_eq!(asked(&gate, get.clone(), "/?token=right", &[(HOST, "evil.example:7300")]), forbidden);
        assert_eq!(asked(&gate, get.clone(), "/?token=right", &[]), forbidden);
        let from = |origin: &'static str| (ORIGIN, origin);
        assert_eq!(asked(&gate, get, "/data", &[host.clone(), cookie.clone(), from("http://evil.example")]), forbidden);
        assert_eq!(asked(&gate, post.clone(), "/run", &[host.clone(), cookie.clone(), from("null")]), forbidden);
        let other_port = (HeaderName::from_static("sec-fetch-site"), "same-site");
        assert_eq!(asked(&gate, Method::GET, "/data", &[host.clone(), cookie.clone(), other_port]), forbidden);
        assert_eq!(asked(&gate, post.clone(), "/run", &[host.clone(), cookie.clone()]), forbidden);
        let page = from("http://127.0.0.1:7300");
        assert_eq!(asked(&gate, post.clone(), "/run", &[host.clone(), cookie, page.clone()]), Ok(Admitted::In));
        assert_eq!(asked(&gate, post, "/run", &[host, page]), unknown);
    }
}
