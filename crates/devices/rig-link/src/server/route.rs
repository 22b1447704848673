//! Routes of requests. Names are compared with existing ones, so a name here is any text; see
//! [`crate::store`].

use hyper::Method;

use crate::link::from_address;

/// A route.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Route {
    /// A file of the page, by its position in [`super::page::FILES`].
    Page(usize),
    Status,
    Preview(usize),
    Act,
    Login,
    Logout,
    Sessions,
    Manifest(String),
    File(String, String),
    Receipt(String),
    Free(String),
}

/// Reason for no route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoRoute {
    Unknown,
    /// The address exists, for these methods.
    Method(&'static str),
}

const READ: &str = "GET, HEAD";
const WRITE: &str = "POST";

impl Route {
    /// The route of a method and a path.
    pub(super) fn of(method: &Method, path: &str) -> Result<Self, NoRoute> {
        let route = Self::of_path(path).ok_or(NoRoute::Unknown)?;
        let allowed = if route.changes() { WRITE } else { READ };
        let fits = match *method {
            Method::GET | Method::HEAD => !route.changes(),
            Method::POST => route.changes(),
            _ => false,
        };
        if fits {
            Ok(route)
        } else {
            Err(NoRoute::Method(allowed))
        }
    }

    fn of_path(path: &str) -> Option<Self> {
        let Some(api) = path.strip_prefix("/api/") else {
            return super::page::position(path).map(Self::Page);
        };
        let (first, rest) = match api.split_once('/') {
            Some((first, rest)) => (first, Some(rest)),
            None => (api, None),
        };
        match (first, rest) {
            ("status", None) => Some(Self::Status),
            ("act", None) => Some(Self::Act),
            ("login", None) => Some(Self::Login),
            ("logout", None) => Some(Self::Logout),
            ("sessions", None) => Some(Self::Sessions),
            ("preview", Some(camera)) => {
                let plain = camera.len() <= 3 && camera.bytes().all(|b| b.is_ascii_digit());
                let camera = plain.then(|| camera.parse().ok()).flatten()?;
                Some(Self::Preview(camera))
            }
            ("sessions", Some(rest)) => {
                let (name, what) = rest.split_once('/')?;
                let name = from_address(name)?;
                match what.split_once('/') {
                    None if what == "manifest" => Some(Self::Manifest(name)),
                    None if what == "receipt" => Some(Self::Receipt(name)),
                    None if what == "free" => Some(Self::Free(name)),
                    Some(("files", file)) => Some(Self::File(name, from_address(file)?)),
                    _ => None,
                }
            }
            _ => None,
        }
    }

    /// Whether it modifies state.
    pub(super) fn changes(&self) -> bool {
        matches!(
            self,
            Self::Act | Self::Login | Self::Logout | Self::Receipt(_) | Self::Free(_)
        )
    }

    /// Whether it needs no token: the page itself, which contains no data, and the login.
    pub(super) fn is_open(&self) -> bool {
        matches!(self, Self::Page(_) | Self::Login | Self::Logout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_routed() {
        let get = |path| Route::of(&Method::GET, path);
        let post = |path| Route::of(&Method::POST, path);
        assert!(matches!(get("/"), Ok(Route::Page(_))));
        assert_eq!(get("/api/preview/2"), Ok(Route::Preview(2)));
        let file = Route::File("walk 1".to_owned(), "rig/a b".to_owned());
        assert_eq!(get("/api/sessions/walk%201/files/rig/a%20b"), Ok(file));
        assert_eq!(
            post("/api/sessions/w/free"),
            Ok(Route::Free("w".to_owned()))
        );
        // Decoded once: this is a file name, compared with existing names.
        let odd = Route::File("w".to_owned(), "%2e%2e/x".to_owned());
        assert_eq!(get("/api/sessions/w/files/%252e%252e/x"), Ok(odd));
        for path in [
            "",
            "/x",
            "//",
            "/api",
            "/api/",
            "/api/status/",
            "/api//status",
            "/api/preview/",
            "/api/preview/-1",
            "/api/preview/+1",
            "/api/preview/1000",
            "/api/sessions/",
            "/api/sessions/w",
            "/api/sessions/w/",
            "/api/sessions/w/files",
            "/api/sessions/w/manifest/",
            "/api/sessions/%zz/manifest",
            "/api/sessions/w/files/%ff",
            "/api/../api/status",
            "/API/status",
        ] {
            assert_eq!(get(path), Err(NoRoute::Unknown), "{path}");
        }
        assert_eq!(post("/api/status"), Err(NoRoute::Method(READ)));
        assert_eq!(get("/api/act"), Err(NoRoute::Method(WRITE)));
        for method in [
            Method::PUT,
            Method::DELETE,
            Method::OPTIONS,
            Method::TRACE,
            Method::CONNECT,
        ] {
            assert!(Route::of(&method, "/api/status").is_err());
        }
    }
}
