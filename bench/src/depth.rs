//! temp
mod exam; mod frames; mod peers; mod real; mod sigma;
use anyhow::Result;
pub(crate) fn run(args: &[String]) -> Result<()> {
    if args.iter().any(|a| a == "--fit") { println!("{}", sigma::fit()?); return Ok(()); }
    let places=exam::held_out(false);
    let frames=exam::render(&places)?;
    for g in sigma::check(&places,&frames)? { println!("{}", g.json()); }
    Ok(())
}
