use super::*;

const BLACK: Color = [0; 3];
const WHITE: Color = [255; 3];

fn drawn(canvas: &Canvas) -> Vec<String> {
    let rows = canvas.pixels.chunks(canvas.width);
    rows.map(|row| {
        row.iter()
            .map(|p| if *p == BLACK { '#' } else { '.' })
            .collect()
    })
    .collect()
}

#[test]
fn shapes_cover_pixels_by_their_centers_and_are_clipped() {
    let mut canvas = Canvas::new(7, 5, WHITE);
    canvas.convex(&[[3.0, 0.0], [6.0, 3.0], [3.0, 3.0]], BLACK);
    canvas.line(&[[-5.0, 4.0], [1.0, 4.0]], 1.0, BLACK);
    canvas.disc([0.0, 0.0], 1.0, BLACK);
    assert_eq!(
        drawn(&canvas),
        ["##.#...", "#..##..", "...###.", "...####", "##....."]
    );
}

#[test]
fn digit_glyph_is_drawn() {
    let mut canvas = Canvas::new(8, 5, WHITE);
    canvas.text([0, 0], 1, "4.", BLACK);
    assert_eq!(
        drawn(&canvas),
        ["#.#.....", "#.#.....", "###.....", "..#.....", "..#..#.."]
    );
}

#[test]
fn polygons_have_holes_share_no_pixel_and_are_clipped() {
    let mut canvas = Canvas::new(6, 4, WHITE);
    let rectangle = |left: f64, right: f64, low: f64, high: f64| {
        [[left, low], [right, low], [right, high], [left, high]]
    };
    // Twice half of the difference to black, unless an edge is drawn twice.
    canvas.polygon(&rectangle(-9.0, 2.0, -9.0, 2.0), BLACK, 0.5);
    canvas.polygon(&rectangle(2.0, 9.0, -9.0, 2.0), BLACK, 0.5);
    assert!(canvas.pixels[..12].iter().all(|p| *p == [128; 3]));
    assert!(canvas.pixels[12..].iter().all(|p| *p == WHITE));

    let mut canvas = Canvas::new(6, 4, WHITE);
    // From the outer to the inner rectangle and back along the same line.
    let outer = rectangle(-0.5, 5.5, -0.5, 3.5);
    let inner = rectangle(1.5, 3.5, 0.5, 2.5);
    let ring: Vec<[f64; 2]> = (outer.iter().chain(&outer[..1]))
        .chain(&inner)
        .chain(&inner[..1])
        .copied()
        .collect();
    canvas.polygon(&ring, BLACK, 1.0);
    assert_eq!(drawn(&canvas), ["######", "##..##", "##..##", "######"]);
}

#[test]
fn a_smaller_canvas_has_the_means_of_blocks() {
    let mut canvas = Canvas::new(5, 2, [10; 3]);
    canvas.paste([0, 0], 1, &[[50, 10, 11]]);
    let small = canvas.downsampled(2);
    assert_eq!((small.width, small.height), (2, 1));
    assert_eq!(small.pixels, [[20, 10, 10], [10; 3]]);
}

#[test]
fn a_png_has_the_pixels() {
    let mut canvas = Canvas::new(3, 2, [1, 2, 3]);
    canvas.paste([2, 1], 1, &[[9, 8, 7]]);
    for compression in [png::Compression::Fast, png::Compression::default()] {
        let file = canvas.png(compression).unwrap();
        let decoder = png::Decoder::new(std::io::Cursor::new(file));
        let mut reader = decoder.read_info().unwrap();
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut data).unwrap();
        assert_eq!(data, canvas.pixels.as_flattened());
    }
    assert!(
        Canvas::new(0, 0, WHITE)
            .png(png::Compression::Fast)
            .is_err()
    );
}
