use simulation::testing::SyntheticScene as S;
fn main() {
    let t = |name: &str, f: &dyn Fn() -> S| {
        let now = std::time::Instant::now();
        let s = f();
        let n: usize = s
            .scene
            .sectors
            .iter()
            .map(|s| s.gaussians.as_ref().unwrap().count())
            .sum();
        println!("{name} {:?} {n}", now.elapsed());
    };
    t("tilt", &|| S::tilted_plane([0.1, 0.0]).unwrap());
    t("stairs", &|| S::stairs().unwrap());
    t("wall", &|| S::wall().unwrap());
    t("room", &|| S::room().unwrap());
    t("bridge", &|| S::bridge().unwrap());
    t("loop", &|| S::corridor_loop().unwrap());
    if let Some(p) = std::env::args().nth(1) {
        let now = std::time::Instant::now();
        let s = simulation::SceneData::open(p.as_ref()).unwrap();
        println!("open {:?} {:?} {:?}", now.elapsed(), s.missing(), s.sectors);
    }
}
