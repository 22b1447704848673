//! URDF: links joined by joints.
//!
//! Contract: every link becomes a part. Joints that move are taken at zero, with a note. Lengths
//! are metres and `rpy` rotations about fixed axes, x first, then y, then z (the URDF
//! specification, ROS wiki, urdf/XML/joint), so the rotation is Rz(yaw) Ry(pitch) Rx(roll). A xacro
//! file has to be expanded before.

use std::collections::{BTreeMap, BTreeSet};

use roxmltree::{Document, Node};

use super::{Cad, Fault, MOST_PARTS, Part};
use crate::transform::RigidTransform;

/// The links of a file.
struct Links<'t> {
    /// Line of each, by name.
    lines: BTreeMap<&'t str, usize>,
    /// Names in the order of the file.
    order: Vec<&'t str>,
}

struct Joint<'t> {
    child: &'t str,
    parent_from_child: RigidTransform,
    line: usize,
}

/// The joints of a file.
#[derive(Default)]
struct Joints<'t> {
    of_parent: BTreeMap<&'t str, Vec<Joint<'t>>>,
    /// Line of the joint that gives a link its parent, by the link's name.
    line_of_child: BTreeMap<&'t str, usize>,
    notes: Vec<String>,
}

/// Parts of a URDF file.
///
/// # Errors
/// Everything that is wrong, with lines.
pub fn parts(text: &str) -> Result<Cad, Vec<Fault>> {
    let document = Document::parse(text).map_err(|error| {
        let line = error.pos().row as usize;
        vec![Fault::at_line(line, format!("not XML: {error}"))]
    })?;
    let robot = robot(&document)?;
    let mut faults = Vec::new();
    let links = Links::read(robot, &mut faults);
    let joints = Joints::read(robot, &links, &mut faults);
    if !faults.is_empty() {
        return Err(faults);
    }
    let root = root_of(&links, &joints)?;
    let parts = assemble(root, &links, &joints)?;
    Ok(Cad {
        parts,
        notes: joints.notes,
    })
}

fn line(node: Node<'_, '_>) -> usize {
    node.document().text_pos_at(node.range().start).row as usize
}

/// The element of the robot, in a file without xacro.
fn robot<'a, 'i>(document: &'a Document<'i>) -> Result<Node<'a, 'i>, Vec<Fault>> {
    let root = document.root_element();
    let xacro = |node: &Node<'_, '_>| {
        node.tag_name()
            .namespace()
            .is_some_and(|uri| uri.contains("xacro"))
    };
    if let Some(node) = root.descendants().find(xacro) {
        let message = "is xacro: expand it first (ros2 run xacro xacro FILE > FILE.urdf)";
        return Err(vec![Fault::at_line(line(node), message)]);
    }
    if root.tag_name().name() != "robot" {
        let found = root.tag_name().name();
        return Err(vec![Fault::at_line(
            line(root),
            format!("is <{found}>, expected <robot>"),
        )]);
    }
    Ok(root)
}

impl<'a> Links<'a> {
    fn read(robot: Node<'a, '_>, faults: &mut Vec<Fault>) -> Self {
        let mut lines: BTreeMap<&str, usize> = BTreeMap::new();
        let mut order = Vec::new();
        for link in robot.children().filter(|n| n.has_tag_name("link")) {
            let at = line(link);
            match link
                .attribute("name")
                .filter(|name| !name.trim().is_empty())
            {
                None => faults.push(Fault::at_line(at, "<link> has no name")),
                Some(name) => match lines.insert(name, at) {
                    None => order.push(name),
                    Some(first) => {
                        let message = format!("link {name:?} is there already, on line {first}");
                        faults.push(Fault::at_line(at, message));
                    }
                },
            }
        }
        Self { lines, order }
    }
}

impl<'a> Joints<'a> {
    fn read(robot: Node<'a, '_>, links: &Links<'a>, faults: &mut Vec<Fault>) -> Self {
        let mut joints = Self::default();
        for joint in robot.children().filter(|n| n.has_tag_name("joint")) {
            joints.add(joint, links, faults);
        }
        joints
    }

    fn add(&mut self, joint: Node<'a, '_>, links: &Links<'a>, faults: &mut Vec<Fault>) {
        let at = line(joint);
        let name = joint.attribute("name").unwrap_or("");
        let mut fault =
            |message: String| faults.push(Fault::at_line(at, format!("joint {name:?} {message}")));
        let end = |tag: &str| {
            let node = joint.children().find(|n| n.has_tag_name(tag))?;
            node.attribute("link")
        };
        let (Some(parent), Some(child)) = (end("parent"), end("child")) else {
            fault("has no <parent link> or no <child link>".to_owned());
            return;
        };
        for link in [parent, child] {
            if !links.lines.contains_key(link) {
                fault(format!("names link {link:?}, which is not in the file"));
            }
        }
        if let Some(first) = self.line_of_child.insert(child, at) {
            fault(format!(
                "gives link {child:?} a second parent; the first is on line {first}"
            ));
            return;
        }
        let kind = joint.attribute("type").unwrap_or("");
        if kind != "fixed" {
            self.notes.push(format!(
                "line {at}: joint {name:?} is {kind:?}, taken at zero"
            ));
        }
        match origin(joint) {
            Err(message) => fault(message),
            Ok(parent_from_child) => self.of_parent.entry(parent).or_default().push(Joint {
                child,
                parent_from_child,
                line: at,
            }),
        }
    }
}

/// Transform of a joint; the identity if the joint states none.
fn origin(joint: Node<'_, '_>) -> Result<RigidTransform, String> {
    let origin = joint.children().find(|n| n.has_tag_name("origin"));
    let three = |key: &str| match origin.and_then(|o| o.attribute(key)) {
        None => Ok([0.0; 3]),
        Some(text) => three_numbers(text).map_err(|found| format!("has {key} = {text:?}: {found}")),
    };
    let (xyz, rpy) = (three("xyz")?, three("rpy")?);
    from_rpy(rpy, xyz).map_err(|error| format!("has an impossible origin: {error}"))
}

/// The only link without a parent.
fn root_of<'a>(links: &Links<'a>, joints: &Joints<'a>) -> Result<&'a str, Vec<Fault>> {
    let roots: Vec<&str> = links
        .order
        .iter()
        .copied()
        .filter(|name| !joints.line_of_child.contains_key(name))
        .collect();
    let message = match roots.as_slice() {
        [root] => return Ok(*root),
        [] if links.order.is_empty() => "there are no links".to_owned(),
        [] => "every link is the child of another: the joints are a circle".to_owned(),
        several => format!(
            "the links {} have no parent, expected one root",
            several.join(", ")
        ),
    };
    Err(vec![Fault::at_line(1, message)])
}

/// The links from the root outwards, those of one parent in the order of its joints.
fn assemble<'a>(
    root: &'a str,
    links: &Links<'a>,
    joints: &Joints<'a>,
) -> Result<Vec<Part>, Vec<Fault>> {
    let mut parts = Vec::new();
    let mut seen = BTreeSet::new();
    let start = RigidTransform::identity();
    let mut open = vec![(root, String::new(), start, links.lines[root])];
    while let Some((name, above, root_from_part, at)) = open.pop() {
        let path = match above.as_str() {
            "" => name.to_owned(),
            above => format!("{above}/{name}"),
        };
        seen.insert(name);
        if parts.len() >= MOST_PARTS {
            return Err(vec![Fault::at_line(
                at,
                format!("more than {MOST_PARTS} links"),
            )]);
        }
        for joint in joints
            .of_parent
            .get(name)
            .map(Vec::as_slice)
            .unwrap_or_default()
            .iter()
            .rev()
        {
            let root_from_child = root_from_part * joint.parent_from_child;
            open.push((joint.child, path.clone(), root_from_child, joint.line));
        }
        parts.push(Part {
            name: name.to_owned(),
            path,
            root_from_part,
            place: format!("line {at}"),
        });
    }
    if let Some(lost) = links.order.iter().find(|name| !seen.contains(*name)) {
        let message =
            format!("link {lost:?} is not connected to {root:?}: its joints are a circle");
        return Err(vec![Fault::at_line(links.lines[lost], message)]);
    }
    Ok(parts)
}

/// From roll, pitch and yaw about fixed axes, rad.
pub(super) fn from_rpy(
    [roll, pitch, yaw]: [f64; 3],
    translation_m: [f64; 3],
) -> Result<RigidTransform, crate::TransformError> {
    let turn = |vector: [f64; 3]| RigidTransform::from_rotation_vector(vector, [0.0; 3]);
    let rotation = turn([0.0, 0.0, yaw])? * turn([0.0, pitch, 0.0])? * turn([roll, 0.0, 0.0])?;
    Ok(RigidTransform::from_translation_m(translation_m)? * rotation)
}

/// Three numbers between blanks.
fn three_numbers(text: &str) -> Result<[f64; 3], String> {
    let mut numbers = Vec::new();
    for word in text.split_whitespace() {
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => numbers.push(number),
            _ if word.contains(',') => {
                return Err(format!(
                    "{word:?} has a comma; decimals are written with a point"
                ));
            }
            _ => return Err(format!("{word:?} is not a finite number")),
        }
    }
    let found = numbers.len();
    numbers
        .try_into()
        .map_err(|_| format!("found {found} numbers, expected 3"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cad::{Format, read_bytes};

    const ARM: &str = r#"<?xml version="1.0"?>
<robot name="plate">
  <link name="base"/>
  <link name="mount"/>
  <link name="camera"/>
  <joint name="a" type="fixed">
    <parent link="base"/><child link="mount"/>
    <origin xyz="0.02 0.14 0.1" rpy="0 0 1.5707963267948966"/>
  </joint>
  <joint name="b" type="revolute">
    <parent link="mount"/><child link="camera"/>
    <origin rpy="-1.5707963267948966 0 -1.5707963267948966" xyz="0.01 0 0"/>
  </joint>
</robot>"#;

    #[test]
    fn links_are_placed_from_the_root() {
        let cad = parts(ARM).unwrap();
        let paths: Vec<&str> = cad.parts.iter().map(|p| p.path.as_str()).collect();
        assert_eq!(paths, ["base", "base/mount", "base/mount/camera"]);
        let camera = &cad.parts[2].root_from_part;
        // The camera is 1 cm along the mount's x, which is the root's y.
        for (found, expected) in camera.translation_m().iter().zip([0.02, 0.15, 0.1]) {
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
        // The usual optical rotation: z of the camera is x of the mount.
        let z = camera.rotate([0.0, 0.0, 1.0]);
        assert!((z[1] - 1.0).abs() < 1e-15, "{z:?}");
        let x = camera.rotate([1.0, 0.0, 0.0]);
        assert!((x[0] - 1.0).abs() < 1e-15, "{x:?}");
        assert_eq!(
            cad.notes,
            ["line 10: joint \"b\" is \"revolute\", taken at zero"]
        );
        assert_eq!(cad.find("camera").unwrap(), &cad.parts[2]);
        assert!(
            cad.find("cam").unwrap_err().contains("nearest is"),
            "{:?}",
            cad.find("cam")
        );
    }

    #[test]
    fn faults_are_all_reported_with_lines() {
        let check = |from: &str, to: &str, expected: &str| {
            let text = ARM.replace(from, to);
            assert_ne!(text, ARM);
            let error = read_bytes(text.as_bytes(), Format::Urdf)
                .unwrap_err()
                .to_string();
            assert!(error.contains(expected), "{to}: {error}");
        };
        check(
            "0.02 0.14",
            "0,02 0.14",
            "line 6: joint \"a\" has xyz = \"0,02 0.14 0.1\": \"0,02\" has a comma",
        );
        check("0.02 0.14", "nan 0.14", "\"nan\" is not a finite number");
        check("0.02 0.14", "0.14", "found 2 numbers, expected 3");
        check("0.02 0.14", "20 140", "are the numbers in another unit");
        check(
            "child link=\"camera\"",
            "child link=\"came\"",
            "line 10: joint \"b\" names link \"came\"",
        );
        check(
            "<link name=\"camera\"/>",
            "<link name=\"mount\"/>",
            "line 5: link \"mount\" is there already, on line 4",
        );
        check("</robot>", "", "not XML");
        check(
            "child link=\"camera\"",
            "child link=\"mount\"",
            "a second parent",
        );
        check(
            "parent link=\"base\"",
            "parent link=\"camera\"",
            "not connected to \"base\"",
        );
        check(
            "<link name=\"base\"/>",
            "<link name=\"base\"/><link name=\"other\"/>",
            "expected one root",
        );
        check(
            "<link name=\"base\"/>",
            "<x:macro xmlns:x=\"http://wiki.ros.org/xacro\"/>",
            "line 3: is xacro",
        );
        for cut in 0..ARM.len() - 1 {
            assert!(parts(&ARM[..cut]).is_err(), "cut at {cut}");
        }
    }
}
