//! What every chart promises, over ordinary, hostile and very many values.

use crate::axis::{Extent, Scale, linear_step};
use crate::geometry::{Rect, cells, clip_line, clip_polygon, columns, thin};
use crate::labels::Placer;
use crate::series::Shape;
use crate::svg::{escape, shorten, text_width, wrap};
use crate::*;

/// A small seeded generator.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % sides
    }

    fn uniform(&mut self) -> f64 {
        self.roll(1 << 30) as f64 / f64::from(1 << 30)
    }

    /// Values that break careless drawing code, among ordinary ones.
    fn hostile(&mut self) -> f64 {
        const NASTY: [f64; 16] = [
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::MAX,
            f64::MIN,
            f64::MIN_POSITIVE,
            5e-324,
            0.0,
            -0.0,
            1e99,
            -1e99,
            1.7e18,
            1.7e18 + 1024.0,
            1e-99,
            -1e-7,
            1.0,
        ];
        match self.roll(3) {
            0 => NASTY[self.roll(NASTY.len())],
            1 => self.uniform() * 1e3 - 300.0,
            _ => self.uniform(),
        }
    }
}

fn numbers(text: &str) -> Vec<f64> {
    text.split([' ', ','])
        .filter(|n| !n.is_empty())
        .map(|n| n.parse().unwrap())
        .collect()
}

fn attribute<'a>(element: &'a str, name: &str) -> &'a str {
    let start = element.find(&format!(" {name}=\"")).unwrap() + name.len() + 3;
    &element[start..start + element[start..].find('"').unwrap()]
}

/// The plot area, as the frame around it says.
fn plot(svg: &str) -> Rect {
    let frame = svg
        .lines()
        .find(|l| l.starts_with("<rect") && l.contains("#8a8a8a"))
        .unwrap();
    let [x, y, w, h] =
        ["x", "y", "width", "height"].map(|name| attribute(frame, name).parse::<f64>().unwrap());
    Rect {
        x0: x - 0.05,
        y0: y - 0.05,
        x1: x + w + 0.05,
        y1: y + h + 0.05,
    }
}

/// What holds for every chart: balanced elements, no number that is not finite, and no line, area,
/// bar or grid line outside the plot.
fn check(svg: &str) {
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"));
    assert!(
        !svg.contains("NaN") && !svg.contains("inf") && !svg.contains("href"),
        "{svg}"
    );
    let body = svg
        .split_once('>')
        .unwrap()
        .1
        .strip_suffix("</svg>\n")
        .unwrap();
    for line in body.lines().filter(|l| !l.is_empty()) {
        let whole = line.ends_with("/>") || line.ends_with("</text>") || line.ends_with("</title>");
        let inside = line
            .strip_suffix("/>")
            .or(line.rsplit_once("</").map(|p| p.0))
            .unwrap_or(line);
        let raw = inside.matches('<').count() - 1 + inside.matches(['\'', '\0']).count();
        assert!(whole && raw == 0, "{line}");
    }
    for part in svg.split("=\"#").skip(1) {
        let colour = format!("#{}", part.split('"').next().unwrap());
        let is_known = crate::theme::COLOURS
            .iter()
            .any(|(light, _)| *light == colour);
        assert!(is_known, "{colour} has no colour for the dark");
    }
    if !svg.contains("#8a8a8a") {
        return;
    }
    let area = plot(svg);
    for line in body.lines().filter(|l| l.starts_with("<poly")) {
        for p in numbers(attribute(line, "points")).chunks(2) {
            assert!(area.contains((p[0], p[1])), "{p:?} outside {area:?}");
        }
    }
}

fn hostile_chart(dice: &mut Dice) -> Chart {
    let axis = |dice: &mut Dice| {
        let (from, to) = (dice.hostile(), dice.hostile());
        match dice.roll(7) {
            0 => Axis::log("l<o>g", "\"&'"),
            1 => Axis::time("time"),
            2 => Axis::categories(
                "",
                [
                    "a",
                    "b & c",
                    "a long name that does not fit <below> its bar",
                ],
            ),
            3 => Axis::linear("wide", "").include(from).include(to),
            4 => Axis::log("wide", "").include(from).include(to),
            _ => Axis::linear("linear", "u").include(from),
        }
    };
    let mut chart = Chart::new("hostile <&>")
        .x_axis(axis(dice))
        .y_axis(axis(dice))
        .subtitle("\0 \u{1b}");
    for i in 0..dice.roll(4) {
        let n = [0, 1, 2, 7, 400, 4000][dice.roll(6)];
        let points: Vec<(f64, f64)> = (0..n).map(|_| (dice.hostile(), dice.hostile())).collect();
        let values: Vec<f64> = points.iter().map(|p| p.0).collect();
        let name = format!("s<{i}>");
        chart = chart.series(match dice.roll(6) {
            0 => Series::line(&name, points).labels(["a & b", "", "c"]),
            1 => Series::steps(&name, points),
            2 => Series::scatter(&name, points).labels(["first", "second"]),
            3 => Series::bars(&name, values),
            4 => Series::histogram(&name, values, Bins::Count(dice.roll(50))),
            _ => Series::histogram(&name, values, Bins::Width(dice.hostile())),
        });
    }
    let (a, b) = (dice.hostile(), dice.hostile());
    chart.hline(a, "h & l").vline(b, "v < l")
}

#[test]
fn any_chart_stays_inside_its_plot_and_is_the_same_twice() {
    for seed in 0..1500 {
        let chart = hostile_chart(&mut Dice(seed));
        let svg = chart.to_svg(280 + seed as u32 % 700, 100 + seed as u32 % 400);
        check(&svg);
        assert_eq!(
            svg,
            hostile_chart(&mut Dice(seed)).to_svg(280 + seed as u32 % 700, 100 + seed as u32 % 400)
        );
    }
}

#[test]
fn any_timeline_can_be_drawn() {
    for seed in 0..500 {
        let mut dice = Dice(seed);
        let mut timeline = Timeline::new("<t>", Axis::time("time"))
            .kinds(["ok", "<gap>"])
            .mark(dice.hostile(), "m & m");
        for _ in 0..dice.roll(5) {
            let n = dice.roll(50);
            let spans = (0..n).map(|_| Span {
                from: dice.hostile(),
                to: dice.hostile(),
                kind: dice.roll(9),
            });
            let spans: Vec<Span> = spans.collect();
            timeline = timeline.row("row \"&\"", "note", spans);
        }
        check(&timeline.to_svg(700));
    }
}

#[test]
fn what_is_left_out_is_counted_and_breaks_the_line() {
    let points = [
        (0.0, 1.0),
        (1.0, 2.0),
        (2.0, f64::NAN),
        (3.0, 3.0),
        (4.0, 2.0),
        (5.0, f64::INFINITY),
        (f64::NAN, 0.0),
    ];
    let svg = Chart::new("")
        .series(Series::line("x", points))
        .to_svg(400, 200);
    assert!(svg.contains("x: 3 points not finite"));
    assert_eq!(svg.matches("<polyline").count(), 2);
    let log = Chart::new("")
        .y_axis(Axis::log("", ""))
        .series(Series::line("", [(0.0, 0.0), (1.0, 1.0), (2.0, 9.0)]));
    assert!(
        log.to_svg(400, 200)
            .contains(">1 point not above zero, which a log axis cannot show<")
    );
    let limit = Chart::new("")
        .y_axis(Axis::log("", ""))
        .hline(-5.0, "limit");
    assert!(
        limit
            .to_svg(400, 200)
            .contains(">the line at -5 (limit) cannot be shown<")
    );
    let bins = Series::histogram("", [0.5, 1.0, 2.0, f64::NAN], Bins::Width(1.0));
    let bins = Chart::new("").series(bins).to_svg(400, 200);
    assert!(bins.contains(">1 point not finite<"));
}

#[test]
fn a_line_breaks_on_purpose_without_a_note() {
    let points = [(0.0, 1.0), (1.0, 2.0), BREAK, (3.0, 3.0), (4.0, 2.0)];
    let svg = Chart::new("")
        .series(Series::line("x", points))
        .to_svg(400, 200);
    assert_eq!(svg.matches("<polyline").count(), 2);
    assert!(!svg.contains("not finite"), "{svg}");
}

#[test]
fn no_data_is_said_and_no_scale_is_invented() {
    for series in [
        Series::line("", []),
        Series::bars("", []),
        Series::scatter("", [(f64::NAN, 1.0)]),
    ] {
        let svg = Chart::new("t").series(series).to_svg(400, 200);
        check(&svg);
        assert!(
            svg.contains(">no data<") && !svg.contains(">0.5<") && !svg.contains("<line"),
            "{svg}"
        );
    }
    assert!(
        Timeline::new("t", Axis::time(""))
            .to_svg(400)
            .contains(">no data<")
    );
}

#[test]
fn an_hour_of_data_stays_small_and_keeps_its_extremes() {
    let mut dice = Dice(1);
    let mut noise = || -> Vec<(f64, f64)> {
        (0..108_000)
            .map(|i| (f64::from(i) / 30.0, dice.uniform()))
            .collect()
    };
    let (a, mut b, c) = (noise(), noise(), noise());
    b[54_321].1 = 1000.0;
    let lines = Chart::new("")
        .series(Series::line("a", a.clone()))
        .series(Series::steps("b", b))
        .series(Series::line("c", c));
    let lines = lines.to_svg(720, 300);
    check(&lines);
    assert!(lines.len() < 100_000, "{} bytes", lines.len());
    let area = plot(&lines);
    let high = area.y0 + (area.y1 - area.y0) / 4.0;
    let spike = lines
        .lines()
        .filter(|l| l.starts_with("<polyline"))
        .any(|l| {
            numbers(attribute(l, "points"))
                .chunks(2)
                .any(|p| p[1] < high)
        });
    assert!(spike, "the one high value is missing");
    let torn = a
        .iter()
        .enumerate()
        .map(|(i, p)| (p.0, if i % 3 == 0 { f64::NAN } else { p.1 }));
    let torn = Chart::new("")
        .series(Series::line("", torn))
        .to_svg(720, 300);
    assert!(torn.len() < 100_000, "{} bytes", torn.len());
    let scatter = Chart::new("")
        .series(Series::scatter("", a))
        .to_svg(720, 300);
    assert!(scatter.len() < 100_000, "{} bytes", scatter.len());
}

#[test]
fn a_short_gap_shows_among_a_hundred_thousand_events() {
    let events = (0..100_000).map(|i| Span {
        from: f64::from(i) * 0.036,
        to: f64::from(i) * 0.036 + 0.03,
        kind: 0,
    });
    let gap = Span {
        from: 1800.0,
        to: 1800.001,
        kind: 2,
    };
    let timeline = Timeline::new("", Axis::time("")).kinds(["present", "late", "gap"]);
    let svg = timeline.row("a", "", events.chain([gap])).to_svg(720);
    assert!(svg.len() < 5_000, "{} bytes", svg.len());
    let path = svg
        .lines()
        .find(|l| l.contains("<path") && l.contains("#D55E00"))
        .unwrap();
    assert!(path.contains("h1v"), "{path}");
}

#[test]
fn columns_keep_the_worst_kind_and_cover_every_span() {
    let (long, short) = ((0.0, 10.0, 0), (4.2, 4.3, 1));
    let expected = [(0, 4, 0), (4, 1, 1), (5, 5, 0)];
    assert_eq!(columns([long, short].into_iter(), 10), expected);
    assert_eq!(columns([short, long].into_iter(), 10), expected);
    assert_eq!(
        columns(
            [(10.0, 10.0, 3), (-5.0, -1.0, 2), (2.0, 2.0, 1)].into_iter(),
            10
        ),
        [(2, 1, 1), (9, 1, 3)]
    );
    assert_eq!(columns([(0.0, 1.0, 0)].into_iter(), 0), []);
}

#[test]
fn thinning_keeps_order_and_the_extremes_of_every_column() {
    let mut dice = Dice(3);
    let points: Vec<_> = (0..5000)
        .map(|i| (f64::from(i) * 0.02, dice.uniform() * 100.0))
        .collect();
    let thinned = thin(&points);
    assert!(thinned.len() <= 200);
    let mut rest = points.iter();
    assert!(
        thinned.iter().all(|t| rest.any(|p| p == t)),
        "not a subsequence"
    );
    for column in 0..100 {
        let extent = |of: &[(f64, f64)]| {
            let mut extent = Extent::default();
            of.iter()
                .filter(|p| p.0.floor() == f64::from(column))
                .for_each(|p| extent.add(p.1));
            extent.0
        };
        assert_eq!(extent(&points), extent(&thinned));
    }
    let strokes = cells(&[(0.5, 0.5), (0.6, 3.0), (0.7, 9.0), (5.0, 0.0)], 2.0);
    assert_eq!(
        strokes,
        [((1.0, 1.0), 2.0), ((1.0, 9.0), 0.0), ((5.0, 1.0), 0.0)]
    );
}

#[test]
fn clipping_cuts_exactly_at_the_border() {
    let rect = Rect {
        x0: 0.0,
        y0: 0.0,
        x1: 10.0,
        y1: 10.0,
    };
    let line = [
        (-5.0, 5.0),
        (5.0, 5.0),
        (5.0, 15.0),
        (8.0, 15.0),
        (8.0, 5.0),
    ];
    let pieces = clip_line(&line, rect);
    assert_eq!(
        pieces,
        [
            vec![(0.0, 5.0), (5.0, 5.0), (5.0, 10.0)],
            vec![(8.0, 10.0), (8.0, 5.0)]
        ]
    );
    assert!(clip_line(&[(-1.0, 5.0), (5.0, 11.0)], rect).len() == 1);
    assert!(clip_line(&[(-1.0, 9.5), (1.0, 11.5)], rect).is_empty());
    let triangle = clip_polygon(vec![(-10.0, 0.0), (10.0, 0.0), (10.0, 20.0)], rect);
    let doubled: f64 = triangle
        .iter()
        .zip(triangle.iter().cycle().skip(1))
        .map(|(a, b)| a.0 * b.1 - b.0 * a.1)
        .sum();
    assert_eq!(doubled.abs() / 2.0, 100.0);
}

#[test]
fn ticks_are_round_few_and_distinct() {
    let mut dice = Dice(5);
    for _ in 0..20_000 {
        let lo = (dice.uniform() - 0.5) * 10f64.powi(dice.roll(24) as i32 - 12);
        let hi = lo + 10f64.powi(dice.roll(24) as i32 - 12).max(lo.abs() * 1e-9);
        let most = 2 + dice.roll(10);
        for axis in [Axis::linear("", ""), Axis::time("")] {
            let ticks = axis.ticks((lo, hi), most);
            assert!(ticks.len() <= most + 2, "{lo}..{hi}: {ticks:?}");
            assert!(
                ticks
                    .iter()
                    .all(|t| t.0 >= lo - (hi - lo) * 1e-6 && t.0 <= hi + (hi - lo) * 1e-6)
            );
            assert!(
                ticks
                    .windows(2)
                    .all(|t| t[0].0 < t[1].0 && t[0].1 != t[1].1),
                "{lo}..{hi}: {ticks:?}"
            );
        }
        let (lo, hi) = (lo.abs(), lo.abs() * (1.01 + 1e6 * dice.uniform().powi(9)));
        let ticks = Axis::log("", "").ticks((lo, hi), most);
        assert!(
            ticks.len() >= 2 && ticks.windows(2).all(|t| t[0].1 != t[1].1),
            "{lo}..{hi}: {ticks:?}"
        );
    }
    let texts = |axis: Axis, lo: f64, hi: f64| {
        axis.ticks((lo, hi), 4)
            .into_iter()
            .map(|t| t.1)
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert_eq!(
        texts(Axis::linear("", ""), -1.0, 1.0),
        "-1.0 -0.5 0 0.5 1.0"
    );
    assert_eq!(
        texts(Axis::linear("", ""), 0.0, 4e6),
        "0 10⁶ 2×10⁶ 3×10⁶ 4×10⁶"
    );
    assert_eq!(texts(Axis::log("", ""), 0.02, 300.0), "0.1 1 10 100");
    assert_eq!(texts(Axis::log("", ""), 1.0, 20.0), "1 2 5 10 20");
    assert_eq!(
        texts(Axis::log("", ""), 5.0, 6.0),
        "5.0 5.2 5.4 5.6 5.8 6.0"
    );
    assert_eq!(
        texts(Axis::time(""), 0.0, 3600.0),
        "0:00:00 0:15:00 0:30:00 0:45:00 1:00:00"
    );
    assert_eq!(texts(Axis::time(""), 0.0, 200.0), "0:00 1:00 2:00 3:00");
    assert_eq!(
        [0.9, 1.0, 1.1, 3.0].map(|span| linear_step(span, 1)),
        [1.0, 1.0, 2.0, 5.0]
    );
}

#[test]
fn numbers_in_words() {
    let si = [0.0, 0.01, 1.5e9, 999.96, -2.5e-7, 1e30, f64::NAN].map(|v| si(v, "B"));
    assert_eq!(
        si,
        [
            "0 B",
            "10 mB",
            "1.5 GB",
            "1 kB",
            "-250 nB",
            "10¹² EB",
            "n/a B"
        ]
    );
    let plain = [1234.5, 99.96, 0.012345, 1e-9, 2.1e-9, -1.25e10].map(significant);
    assert_eq!(
        plain,
        ["1234", "100", "0.0123", "10⁻⁹", "2.1×10⁻⁹", "-1.25×10¹⁰"]
    );
}

#[test]
fn every_value_is_in_a_bin() {
    let mut dice = Dice(9);
    for _ in 0..2000 {
        let values: Vec<f64> = (0..50).map(|_| (dice.uniform() - 0.5) * 1e3).collect();
        for bins in [
            Bins::Count(dice.roll(9)),
            Bins::Width(dice.uniform() * 90.0),
        ] {
            let series = Series::histogram("", values.iter().copied(), bins);
            let Shape::Histogram(histogram) = series.shape else {
                panic!("no histogram");
            };
            assert_eq!(histogram.counts.iter().sum::<u64>(), 50, "{bins:?}");
        }
    }
    let series = Series::histogram("", [0.0, 0.5, 1.0, 2.0], Bins::Width(1.0));
    let Shape::Histogram(histogram) = series.shape else {
        panic!("no histogram");
    };
    assert_eq!(histogram.edges, [0.0, 1.0, 2.0, 3.0]);
    assert_eq!(histogram.counts, [2, 1, 1]);
}

#[test]
fn scales_are_exact_at_their_ends() {
    for log in [false, true] {
        let scale = Scale {
            range: (0.001, 1000.0),
            log,
            pixels: (300.0, 20.0),
        };
        assert_eq!((scale.at(0.001), scale.at(1000.0)), (300.0, 20.0));
    }
    assert_eq!(
        Scale {
            range: (1.0, 100.0),
            log: true,
            pixels: (0.0, 10.0)
        }
        .at(10.0),
        5.0
    );
}

#[test]
fn labels_avoid_each_other() {
    let mut placer = Placer::new(Rect {
        x0: 0.0,
        y0: 0.0,
        x1: 400.0,
        y1: 200.0,
    });
    let size = text_width("a label", 11.0);
    let starts: Vec<_> = (0..5)
        .map(|i| placer.beside((200.0 + f64::from(i) * 3.0, 100.0), "a label"))
        .collect();
    for (i, a) in starts.iter().enumerate() {
        assert!(a.0 >= 0.0 && a.0 + size <= 400.0);
        let clear = |b: &(f64, f64)| (a.0 - b.0).abs() >= size || (a.1 - b.1).abs() >= 11.0;
        assert!(starts[..i].iter().all(clear), "{starts:?}");
    }
    let corner = placer.beside((399.0, 199.0), "a label");
    assert!(corner.0 + size <= 400.0 && corner.1 <= 200.0);
}

#[test]
fn long_words_are_wrapped_and_shortened() {
    let text = "a command with/a/very/long/path/that/has/no/space/at/all --and more";
    let lines = wrap(text, 10.0, 120.0);
    assert!(
        lines.len() > 2 && lines.iter().all(|line| text_width(line, 10.0) <= 120.0),
        "{lines:?}"
    );
    assert_eq!(lines.concat().replace(' ', ""), text.replace(' ', ""));
    assert!(
        shorten(text, 10.0, 80.0).ends_with('…')
            && text_width(&shorten(text, 10.0, 80.0), 10.0) <= 80.0
    );
}

#[test]
fn pages_escape_and_refer_to_nothing() {
    assert_eq!(
        escape("<a href=\"x\">&'\u{8}"),
        "&lt;a href=&quot;x&quot;&gt;&amp;&#39;\u{fffd}"
    );
    let table = Table::new(["n<", "verdict"])
        .row([Cell::number(1.5), Verdict::Fail.into()])
        .row(["<td>".into()]);
    let svg = Chart::new("<svg>").to_svg(300, 200);
    let page = Page::new("</title>")
        .verdict(Verdict::Pass)
        .section("<h2>")
        .text("<p>")
        .table(&table);
    let html = page
        .finding(Verdict::Warn, "<script>")
        .figure(&svg, "<b>")
        .to_html();
    assert_eq!(html.matches("<td ").count(), 3);
    assert!(
        html.contains("<th class=\"n\">n&lt;</th>")
            && html.contains("<td class=\"n\" data-head=\"n&lt;\">1.5</td>")
    );
    assert_eq!(inspect(&html), Ok(()));
    assert!(html.contains("&lt;script&gt;") && !html.contains("<script") && !html.contains("<b>"));
    assert_eq!(
        html.matches("http").count(),
        html.matches("xmlns=\"http").count()
    );
    for badge in [
        "badge pass\">PASS",
        "badge warn\">WARN",
        "badge fail\">FAIL",
    ] {
        assert!(html.contains(badge));
    }
}
