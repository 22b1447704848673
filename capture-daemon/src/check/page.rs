//! Whether the phone's page could be served.

use std::io::ErrorKind;
use std::net::TcpListener;
use std::path::Path;

use rig_link::token::Token;

use super::folder::writable;
use super::report::Report;
use crate::config::{Config, Page};
use crate::error_chain::with_causes;

/// Checks the page's address, token and folder. `daemon_answers`: a daemon runs, and may use the
/// address.
pub(super) fn check(config: &Config, daemon_answers: bool, report: &mut Report) {
    let Some(page) = &config.page else {
        return;
    };
    report.about = "page".to_owned();
    address(page, daemon_answers, report);
    if let Some(path) = &page.token_file {
        match Token::read(path) {
            Err(error) => report.error(format!(
                "{}; `openssl rand -hex 16` makes one, or name another in [page]",
                with_causes(&error)
            )),
            Ok(_) => report.ok(format!("its token is in {}", path.display())),
        }
    }
    if !page.listen.ip().is_loopback() {
        certificate(&page.folder, report);
    }
}

fn address(page: &Page, daemon_answers: bool, report: &mut Report) {
    let listen = page.listen;
    match TcpListener::bind(listen) {
        Ok(_) => report.ok(format!("it will be at {listen}")),
        Err(error) if error.kind() == ErrorKind::AddrInUse && daemon_answers => {
            report.ok(format!("{listen} is in use, as by the daemon that runs"));
        }
        // A daemon tries again until the network is there.
        Err(error) if error.kind() == ErrorKind::AddrNotAvailable => report.warning(format!(
            "no network of this machine has its address now; `pawsd run` tries again every 10 s: {listen}"
        )),
        Err(error) => report.error(format!(
            "it cannot be served: {error}; choose another address in [page] or end what uses this one: {listen}"
        )),
    }
}

/// The certificate is created at the first start.
fn certificate(folder: &Path, report: &mut Report) {
    let Some(there) = folder.ancestors().find(|folder| folder.exists()) else {
        return report.error(format!(
            "its certificate cannot be stored, no parent folder exists: {}",
            folder.display()
        ));
    };
    match writable(there) {
        Ok(()) => report.ok(format!("its certificate is stored in {}", folder.display())),
        Err(error) => report.error(format!(
            "its certificate cannot be stored: {error}: {}",
            folder.display()
        )),
    }
}
