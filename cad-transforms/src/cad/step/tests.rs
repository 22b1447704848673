use super::*;
use crate::cad::{Format, read_bytes};

/// What CadQuery reports for the files in `tests/data`: path, rotation rows, origin in mm.
type ExpectedPlacement = (&'static str, [f64; 9], [f64; 3]);

#[test]
fn placements_are_those_the_cad_program_reports() {
    let s = 0.5_f64.sqrt();
    let (c30, c15, s15) = (
        0.75_f64.sqrt(),
        0.965_925_826_289_068_3,
        0.258_819_045_102_520_76,
    );
    let (c80, s80) = (0.173_648_177_666_930_3, 0.984_807_753_012_208);
    let expected: [ExpectedPlacement; 6] = [
        ("plate", [1., 0., 0., 0., 1., 0., 0., 0., 1.], [0., 0., 0.]),
        (
            "plate/left_mount",
            [c30, -0.5, 0., 0.5, c30, 0., 0., 0., 1.],
            [20., 140., 100.],
        ),
        (
            "plate/left_mount/zed_x_mini",
            [s, -s, 0., s, s, 0., 0., 0., 1.],
            [28.660254038, 145., 105.],
        ),
        (
            "plate/right_mount",
            [c30, 0.5, 0., -0.5, c30, 0., 0., 0., 1.],
            [20., -140., 100.],
        ),
        (
            "plate/right_mount/zed_x_mini",
            [c15, s15, 0., -s15, c15, 0., 0., 0., 1.],
            [28.660254038, -145., 105.],
        ),
        (
            "plate/feet_mount",
            [c80, 0., s80, 0., 1., 0., -s80, 0., c80],
            [80., 0., -120.],
        ),
    ];
    for bytes in [
        &include_bytes!("../../../tests/data/plate_ap214.step")[..],
        include_bytes!("../../../tests/data/plate_ap242.step"),
    ] {
        let cad = parts(bytes).unwrap();
        assert_eq!(cad.parts.len(), expected.len(), "{cad:#?}");
        for (part, (path, rows, mm)) in cad.parts.iter().zip(&expected) {
            assert_eq!(part.path, *path);
            let found = (
                part.root_from_part.rotation_rows(),
                part.root_from_part.translation_m(),
            );
            let turn = found.0.iter().zip(rows).all(|(f, e)| (f - e).abs() < 1e-11);
            let shift = found
                .1
                .iter()
                .zip(mm)
                .all(|(f, e)| (1e3 * f - e).abs() < 1e-8);
            assert!(turn && shift, "{path}: {found:?}");
        }
        assert!(cad.notes.is_empty(), "{:?}", cad.notes);
        // Cut anywhere, the file is refused.
        for cut in (0..bytes.len() - 3).step_by(7) {
            assert!(parts(&bytes[..cut]).is_err(), "cut at {cut}");
        }
    }
}

/// An assembly as SolidWorks lays it out: entities in falling order, blanks everywhere, names of
/// occurrences blank, inches as a converted unit, NONE for no name. Two instances of one clip, the
/// second rotated to y.
const INCHES: &str = "ISO-10303-21;
HEADER;
FILE_DESCRIPTION (( 'STEP AP214' ),
    '1' );
FILE_NAME ('plate.STEP', '2026-03-02T09:12:44', ( '' ), ( '' ), 'SwSTEP 2.0', 'SolidWorks 2024', '' );
FILE_SCHEMA (( 'AUTOMOTIVE_DESIGN' ));
ENDSEC;

DATA;
#93 = CONTEXT_DEPENDENT_SHAPE_REPRESENTATION ( #83, #73 ) ;
#92 = CONTEXT_DEPENDENT_SHAPE_REPRESENTATION ( #82, #72 ) ;
#83 =( REPRESENTATION_RELATIONSHIP ('NONE','NONE', #41, #40 )REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION ( #63 )SHAPE_REPRESENTATION_RELATIONSHIP( ) );
#82 =( REPRESENTATION_RELATIONSHIP ('NONE','NONE', #41, #40 )REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION ( #62 )SHAPE_REPRESENTATION_RELATIONSHIP( ) );
#73 = PRODUCT_DEFINITION_SHAPE ( 'NONE', 'NONE',  #33 ) ;
#72 = PRODUCT_DEFINITION_SHAPE ( 'NONE', 'NONE',  #32 ) ;
#63 = ITEM_DEFINED_TRANSFORMATION ( 'NONE', 'NONE', #50, #53 ) ;
#62 = ITEM_DEFINED_TRANSFORMATION ( 'NONE', 'NONE', #50, #52 ) ;
#57 = DIRECTION ( 'NONE', ( 0.0, 1.0, 0.0 ) ) ;
#56 = DIRECTION ( 'NONE', ( 0.0, 0.0, 1.0 ) ) ;
#55 = CARTESIAN_POINT ( 'NONE', ( -2.0, 0.0, 4.0E+0 ) ) ;
#54 = CARTESIAN_POINT ( 'NONE', ( 1.0, 2.0, 3.0 ) ) ;
#53 = AXIS2_PLACEMENT_3D ( 'NONE', #55, #56, #57 ) ;
#52 = AXIS2_PLACEMENT_3D ( 'NONE', #54, $, $ ) ;
#51 = AXIS2_PLACEMENT_3D ( 'lens datum', #54, #56, #57 ) ;
#50 = AXIS2_PLACEMENT_3D ( 'NONE', #49, $, $ ) ;
#49 = CARTESIAN_POINT ( 'NONE', ( 0.0, 0.0, 0.0 ) ) ;
#41 = SHAPE_REPRESENTATION ( 'clip', ( #50, #51 ), #20 ) ;
#40 = SHAPE_REPRESENTATION ( 'Pl\\X2\\00E4\\X0\\tte', ( #50, #52, #53 ), #20 ) ;
#45 = SHAPE_DEFINITION_REPRESENTATION ( #43, #41 ) ;
#44 = SHAPE_DEFINITION_REPRESENTATION ( #42, #40 ) ;
#43 = PRODUCT_DEFINITION_SHAPE ( 'NONE', 'NONE',  #31 ) ;
#42 = PRODUCT_DEFINITION_SHAPE ( 'NONE', 'NONE',  #30 ) ;
#33 = NEXT_ASSEMBLY_USAGE_OCCURRENCE ( 'NAUO2', ' ', ' ', #30, #31, $ ) ;
#32 = NEXT_ASSEMBLY_USAGE_OCCURRENCE ( 'NAUO1', ' ', ' ', #30, #31, $ ) ;
#31 = PRODUCT_DEFINITION ( 'UNKNOWN', '', #35, #19 ) ;
#30 = PRODUCT_DEFINITION ( 'UNKNOWN', '', #34, #19 ) ;
#35 = PRODUCT_DEFINITION_FORMATION_WITH_SPECIFIED_SOURCE ( 'ANY', '', #37, .NOT_KNOWN. ) ;
#34 = PRODUCT_DEFINITION_FORMATION_WITH_SPECIFIED_SOURCE ( 'ANY', '', #36, .NOT_KNOWN. ) ;
#37 = PRODUCT ( 'clip', 'clip', '', ( #18 ) ) ;
#36 = PRODUCT ( 'Pl\\X2\\00E4\\X0\\tte', 'Pl\\X2\\00E4\\X0\\tte', '', ( #18 ) ) ;
#20 =( GEOMETRIC_REPRESENTATION_CONTEXT ( 3 )GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT ( ( #25 ) )GLOBAL_UNIT_ASSIGNED_CONTEXT ( ( #22, #26, #27 ) )REPRESENTATION_CONTEXT ( 'NONE', 'WORKASPACE' ) );
#22 =( CONVERSION_BASED_UNIT ( 'INCH', #23 )LENGTH_UNIT ( )NAMED_UNIT ( #24 ) );
#23 = LENGTH_MEASURE_WITH_UNIT ( LENGTH_MEASURE( 25.4 ), #21 );
#24 = DIMENSIONAL_EXPONENTS ( 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 ) ;
#21 =( LENGTH_UNIT ( )NAMED_UNIT ( * )SI_UNIT ( .MILLI., .METRE. ) );
#25 = UNCERTAINTY_MEASURE_WITH_UNIT (LENGTH_MEASURE( 3.937E-07 ), #22, 'distance_accuracy_value', 'NONE');
#26 =( NAMED_UNIT ( * )PLANE_ANGLE_UNIT ( )SI_UNIT ( $, .RADIAN. ) );
#27 =( NAMED_UNIT ( * )SI_UNIT ( $, .STERADIAN. )SOLID_ANGLE_UNIT ( ) );
#19 = PRODUCT_DEFINITION_CONTEXT ( 'detailed design', #17, 'design' ) ;
#18 = PRODUCT_CONTEXT ( 'NONE', #17, 'mechanical' ) ;
#17 = APPLICATION_CONTEXT ( 'automotive_design' ) ;
ENDSEC;
END-ISO-10303-21;
";

fn close(part: &Part, expected_mm: [f64; 3], x_in_root: [f64; 3]) {
    let mm = part.root_from_part.translation_m().map(|v| 1e3 * v);
    let x = part.root_from_part.rotate([1.0, 0.0, 0.0]);
    for i in 0..3 {
        assert!((mm[i] - expected_mm[i]).abs() < 1e-9, "{part:?}: {mm:?}");
        assert!((x[i] - x_in_root[i]).abs() < 1e-12, "{part:?}: {x:?}");
    }
}

fn check_inches(text: &str) {
    let cad = parts(text.as_bytes()).unwrap();
    let paths: Vec<&str> = cad.parts.iter().map(|p| p.path.as_str()).collect();
    let expected = [
        "Plätte",
        "Plätte/clip#1",
        "Plätte/clip#1/lens datum",
        "Plätte/clip#2",
        "Plätte/clip#2/lens datum",
    ];
    let mut sorted = paths.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, expected);
    // Occurrences come in the order of the file.
    let of = |mm: [f64; 3]| {
        let near = |p: &&Part| (p.root_from_part.translation_m()[0] - 1e-3 * mm[0]).abs() < 1e-9;
        cad.parts.iter().find(near).expect("a part there")
    };
    close(of([25.4, 0., 0.]), [25.4, 50.8, 76.2], [1.0, 0.0, 0.0]);
    close(of([-50.8, 0., 0.]), [-50.8, 0.0, 101.6], [0.0, 1.0, 0.0]);
    close(of([50.8, 0., 0.]), [50.8, 101.6, 152.4], [0.0, 1.0, 0.0]);
    // Rotated to y, what is ahead by 1 lies at y, and what is aside by 2 at -x.
    close(
        of([-101.6, 0., 0.]),
        [-101.6, 25.4, 177.8],
        [-1.0, 0.0, 0.0],
    );
}

#[test]
fn inches_blank_names_and_two_instances() {
    check_inches(INCHES);
}

#[test]
fn the_relationship_may_run_the_other_way() {
    // Shapes and axes both exchanged: the operator takes the assembly to the part.
    let text = INCHES
        .replace("#41, #40 )REPRESENTATION", "#40, #41 )REPRESENTATION")
        .replace("'NONE', #50, #53 )", "'NONE', #53, #50 )")
        .replace("'NONE', #50, #52 )", "'NONE', #52, #50 )");
    check_inches(&text);
}

#[test]
fn a_shape_behind_a_relationship_is_the_same_shape() {
    // The clip's product has a shape of its own, and the placed one is tied to it.
    let text = INCHES.replace("( #43, #41 ) ;", "( #43, #47 ) ;").replace(
        "DATA;\n",
        "DATA;\n#47 = SHAPE_REPRESENTATION('',(#50),#20);\n#48 = SHAPE_REPRESENTATION_RELATIONSHIP('','',#47,#41);\n",
    );
    check_inches(&text);
}

#[test]
fn an_operator_in_place_of_two_axes() {
    let text = INCHES.replace(
        "#63 = ITEM_DEFINED_TRANSFORMATION ( 'NONE', 'NONE', #50, #53 ) ;",
        "#63=(CARTESIAN_TRANSFORMATION_OPERATOR($,#57,#58,#55,1.)CARTESIAN_TRANSFORMATION_OPERATOR_3D(#56)\
         FUNCTIONALLY_DEFINED_TRANSFORMATION('','')GEOMETRIC_REPRESENTATION_ITEM()REPRESENTATION_ITEM(''));\n\
         #58=DIRECTION('',(-1.,0.,0.));",
    );
    let text = text.replace("($,#57,#58,#55,1.)", "(#57,#58,#55,1.)");
    check_inches(&text);
    let mirrored = text.replace("(-1.,0.,0.)", "(1.,0.,0.)");
    let fault = parts(mirrored.as_bytes()).unwrap_err()[0].to_string();
    assert!(
        fault.contains("#63, CARTESIAN_TRANSFORMATION_OPERATOR: mirrors the part"),
        "{fault}"
    );
    let scaled = text.replace("#55,1.)", "#55,2.)");
    let fault = parts(scaled.as_bytes()).unwrap_err()[0].to_string();
    assert!(fault.contains("scales by 2"), "{fault}");
}

#[test]
fn mapped_items_place_occurrences() {
    let mapped = "#83 = MAPPED_ITEM('',#85,#53);\n#82 = MAPPED_ITEM('',#85,#52);\n#85 = REPRESENTATION_MAP(#50,#41);\n";
    let lines = |text: &str| {
        let gone = [
            "#93 =", "#92 =", "#83 =", "#82 =", "#73 =", "#72 =", "#63 =", "#62 =",
        ];
        let kept = text
            .lines()
            .filter(|line| !gone.iter().any(|g| line.starts_with(g)));
        kept.map(|line| line.to_owned() + "\n").collect::<String>()
    };
    let text = lines(INCHES)
        .replace("( #50, #52, #53 )", "( #50, #82, #83 )")
        .replace("DATA;\n", &format!("DATA;\n{mapped}"));
    check_inches(&text);
    // Without occurrences the items alone make the assembly.
    let text = text
        .replace("#33 = NEXT_", "/* #33 = NEXT_")
        .replace("#31 = PRODUCT_DEF", "*/ #31 = PRODUCT_DEF");
    check_inches(&text);
}

#[test]
fn each_representation_has_its_own_unit() {
    // The clip is drawn in millimetres, its datum 1 mm ahead; the assembly remains in inches.
    let text = INCHES.replace("( #50, #51 ), #20 )", "( #50, #51 ), #28 )").replace(
        "DATA;\n",
        "DATA;\n#28=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#26,#21,#27))REPRESENTATION_CONTEXT('',''));\n",
    );
    let cad = parts(text.as_bytes()).unwrap();
    let datum = cad
        .parts
        .iter()
        .find(|p| p.path.ends_with("clip#2/lens datum") || p.path.ends_with("clip#1/lens datum"));
    let mm: Vec<f64> = cad
        .parts
        .iter()
        .filter(|p| p.name == "lens datum")
        .map(|p| 1e3 * p.root_from_part.translation_m()[2])
        .collect();
    assert!(datum.is_some());
    assert!(
        mm.iter().any(|z| (z - 79.2).abs() < 1e-9) && mm.iter().any(|z| (z - 104.6).abs() < 1e-9),
        "{mm:?}"
    );
}

#[test]
fn faults_name_line_and_entity() {
    let check = |from: &str, to: &str, expected: &str| {
        let text = INCHES.replacen(from, to, 1);
        assert_ne!(text, INCHES, "{from}");
        let error = read_bytes(text.as_bytes(), Format::Step)
            .unwrap_err()
            .to_string();
        assert!(error.contains(expected), "{to}: {error}");
    };
    check(
        "( 1.0, 2.0, 3.0 )",
        "( 1,0, 2,0, 3,0 )",
        "line 21, #54, CARTESIAN_POINT: has 6 coordinates, expected 3 (decimal commas",
    );
    check(
        "( 1.0, 2.0, 3.0 )",
        "( 1.0, NaN, 3.0 )",
        "line 21, #54: found NAN, expected a number",
    );
    check(
        "( 1.0, 2.0, 3.0 )",
        "( 1.0, 2.0 )",
        "line 21, #54, CARTESIAN_POINT: has 2 coordinates",
    );
    check(
        "( 0.0, 0.0, 1.0 )",
        "( 0.0, 0.0, 0.0 )",
        "#56, DIRECTION: is a direction without length",
    );
    check(
        "( 0.0, 0.0, 1.0 )",
        "( 0.0, 1.0, 0.0 )",
        "#51, AXIS2_PLACEMENT_3D: the axis and the reference direction are parallel",
    );
    check("#20 )", "#99 )", "#99: is referred to and not in the file");
    check(
        "( #22, #26, #27 )",
        "( #26, #27 )",
        "#20: names no LENGTH_UNIT",
    );
    check(
        "GLOBAL_UNIT_ASSIGNED_CONTEXT ( ( #22, #26, #27 ) )",
        "",
        "has no GLOBAL_UNIT_ASSIGNED_CONTEXT",
    );
    check(
        ".MILLI., .METRE.",
        ".KILO., .METRE.",
        "are the numbers in another unit",
    );
    check(
        "LENGTH_MEASURE( 25.4 )",
        "LENGTH_MEASURE( -1. )",
        "#23, LENGTH_MEASURE_WITH_UNIT: is not a length above 0",
    );
    check(
        "#93 = CONTEXT_DEPENDENT",
        "#93 = UNKNOWN",
        "#33: occurrence \"clip\" has no placement",
    );
    check(
        "' ', ' ', #30, #31, $",
        "' ', ' ', #31, #31, $",
        "part of itself",
    );
    check(
        "#30 = PRODUCT_DEFINITION",
        "#30 = PRODUCT_DEFINITIONS",
        "joins #30, which is no PRODUCT_DEFINITION",
    );
    check("END-ISO-10303-21;", "", "it is cut off");
}

#[test]
fn a_deep_chain_of_copies_is_refused() {
    // Each level holds the next twice: 2^40 parts in a few lines.
    let mut text = String::from(
        "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#2))REPRESENTATION_CONTEXT('',''));\n#2=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT($,.METRE.));\n#3=CARTESIAN_POINT('',(0.,0.,0.));\n#4=AXIS2_PLACEMENT_3D('',#3,$,$);\n#5=PRODUCT('p','p','',());\n#6=PRODUCT_DEFINITION_FORMATION('','',#5);\n#7=PRODUCT_DEFINITION('','',#6,$);\n#8=PRODUCT_DEFINITION_SHAPE('','',#7);\n#9=SHAPE_DEFINITION_REPRESENTATION(#8,#1000);\n",
    );
    for level in 0..40 {
        let shape = 1000 + 10 * level;
        text += &format!(
            "#{shape}=SHAPE_REPRESENTATION('',(#{},#{}),#1);\n#{}=MAPPED_ITEM('a',#{},#4);\n#{}=MAPPED_ITEM('b',#{},#4);\n#{}=REPRESENTATION_MAP(#4,#{});\n",
            shape + 1,
            shape + 2,
            shape + 1,
            shape + 3,
            shape + 2,
            shape + 3,
            shape + 3,
            shape + 10
        );
    }
    text += "#1400=SHAPE_REPRESENTATION('',(#4),#1);\nENDSEC;\nEND-ISO-10303-21;\n";
    let fault = parts(text.as_bytes()).unwrap_err()[0].to_string();
    assert!(fault.contains("more than 100000 parts"), "{fault}");
}
