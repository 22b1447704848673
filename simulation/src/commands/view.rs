//! `paws-sim view`: an agent in a scene, driven from a page on this machine.

mod drive;
mod server;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use charts::base64;
use clap::Args;
use command_line::complain;
use command_line::output::print;

use super::walk::{SIZE, Walk};
use drive::Drive;

const PAGE: &str = include_str!("view/page.html");

#[derive(Args)]
pub(crate) struct Arguments {
    /// The scene: a bundle, or a scene file of several recordings.
    scene: PathBuf,
    /// Port on 127.0.0.1; 0 takes a free one.
    #[arg(long, value_name = "N", default_value_t = 8660)]
    port: u16,
    /// Seed of starts and goals.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Predicted PSNR of what the agent sees, dB: starts are where it is higher, and the agent
    /// restarts where it is lower; 0 is no limit.
    #[arg(long, value_name = "DB", default_value_t = 0.0)]
    min_support: f64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let walk = Walk::open(&arguments.scene, arguments.seed, arguments.min_support)?;
    let name = arguments.scene.file_name().unwrap_or_default();
    let page = page(&name.to_string_lossy(), &walk)?;
    let announce = |address| {
        let ready = print(format_args!("http://{address}/"));
        complain!("Ctrl-C ends it");
        if let Err(error) = ready {
            log::error!("{error:#}");
        }
    };
    server::serve(arguments.port, page, Drive::new(walk), announce)?;
    Ok(ExitCode::SUCCESS)
}

fn page(name: &str, walk: &Walk) -> Result<String> {
    let escape = |text: &str| {
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        text.replace('>', "&gt;").replace('"', "&quot;")
    };
    let [map_width, map_height] = walk.map.size();
    let [width, height] = SIZE;
    // The title is last: a name with a marker in it is not searched again.
    Ok(PAGE
        .replace("<!--WIDTH-->", &width.to_string())
        .replace("<!--HEIGHT-->", &height.to_string())
        .replace("<!--MAP_WIDTH-->", &map_width.to_string())
        .replace("<!--MAP_HEIGHT-->", &map_height.to_string())
        .replace(
            "<!--WEARER-->",
            if walk.has_wearer() { "" } else { "hidden" },
        )
        .replace("<!--MAP-->", &base64(&walk.map.png()?))
        .replace("<!--TITLE-->", &escape(name)))
}
