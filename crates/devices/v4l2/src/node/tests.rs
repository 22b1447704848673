use std::os::unix::fs::symlink;

use super::*;

/// A fake `sys` and `dev` in a folder.
struct Machine(tempfile::TempDir);

/// A USB device: folder below `devices`, and what is in it.
const ZED: &str = "pci0000:00/0000:00:14.0/usb2/2-1/2-1.3";
const JETSON: &str = "platform/bus@0/3610000.usb/usb1/1-4";

impl Machine {
    fn new() -> Self {
        let machine = Self(tempfile::tempdir().unwrap());
        fs::create_dir_all(machine.sys().join("class/video4linux")).unwrap();
        fs::create_dir_all(machine.dev()).unwrap();
        machine
    }

    fn sys(&self) -> PathBuf {
        self.0.path().join("sys")
    }

    fn dev(&self) -> PathBuf {
        self.0.path().join("dev")
    }

    fn write(&self, folder: &Path, attributes: &[(&str, &str)]) {
        fs::create_dir_all(folder).unwrap();
        for (name, value) in attributes {
            fs::write(folder.join(name), format!("{value}\n")).unwrap();
        }
    }

    fn usb(&self, place: &str, attributes: &[(&str, &str)]) {
        self.write(&self.sys().join("devices").join(place), attributes);
    }

    /// A node of the device whose folder is `parent`.
    fn node(&self, number: u32, parent: &str, driver: &str, card: &str, index: u32) {
        let name = format!("video{number}");
        let parent = self.sys().join("devices").join(parent);
        let folder = parent.join("video4linux").join(&name);
        self.write(&folder, &[("name", card), ("index", &index.to_string())]);
        symlink(&parent, folder.join("device")).unwrap();
        let drivers = self.sys().join("bus/drivers").join(driver);
        fs::create_dir_all(&drivers).unwrap();
        let _ = symlink(drivers, parent.join("driver"));
        symlink(folder, self.sys().join("class/video4linux").join(&name)).unwrap();
        fs::write(self.dev().join(name), "").unwrap();
    }

    /// Two nodes of one ZED, one of a second, a platform camera; even numbers capture.
    fn rig() -> Self {
        let machine = Self::new();
        let zed = [
            ("idVendor", "2b03"),
            ("idProduct", "f682"),
            ("bcdDevice", "0205"),
            ("speed", "5000"),
        ];
        machine.usb(ZED, &zed);
        machine.node(
            10,
            &format!("{ZED}/2-1.3:1.0"),
            "uvcvideo",
            "ZED-M: ZED-M",
            0,
        );
        machine.node(
            11,
            &format!("{ZED}/2-1.3:1.0"),
            "uvcvideo",
            "ZED-M: ZED-M",
            1,
        );
        machine.usb(JETSON, &zed);
        machine.usb(JETSON, &[("speed", "480"), ("serial", "SN 27")]);
        machine.node(
            2,
            &format!("{JETSON}/1-4:1.0"),
            "uvcvideo",
            "ZED-M: ZED-M",
            0,
        );
        machine.node(0, "platform/vivid.0", "vivid", "vivid-000-vid-cap", 0);
        let other = machine.sys().join("class/video4linux/v4l-subdev0");
        machine.write(&other, &[("name", "imx")]);
        machine
    }

    fn list(&self) -> Vec<Node> {
        list_with(&self.sys(), &self.dev(), |path| {
            let name = path.to_str().unwrap();
            Ok(!name.ends_with('1'))
        })
        .unwrap()
    }
}

fn usb(serial: Option<&str>) -> NodeSelector {
    NodeSelector::Usb {
        vendor: 0x2b03,
        product: 0xf682,
        serial: serial.map(str::to_owned),
    }
}

#[test]
fn nodes_of_a_machine() {
    let machine = Machine::rig();
    let nodes = machine.list();
    let names: Vec<_> = nodes
        .iter()
        .map(|n| n.path.file_name().unwrap().to_str().unwrap())
        .collect();
    assert_eq!(names, ["video0", "video2", "video10", "video11"]);

    assert_eq!(nodes[0].card, "vivid-000-vid-cap");
    assert_eq!(nodes[0].driver.as_deref(), Some("vivid"));
    assert_eq!(nodes[0].usb, None);

    assert_eq!(
        nodes[2].usb,
        Some(UsbDevice {
            vendor: 0x2b03,
            product: 0xf682,
            release: 0x0205,
            serial: None,
            port: "2-1.3".into(),
            speed_mbit: 5000,
            controller: "0000:00:14.0".into(),
        })
    );
    assert_eq!(nodes[2].usb.as_ref().unwrap().root_port(), "2-1");
    assert_eq!((nodes[2].index, nodes[3].index), (0, 1));
    assert!(matches!(nodes[3].captures, Ok(false)));

    let jetson = nodes[1].usb.as_ref().unwrap();
    assert_eq!(jetson.controller, "3610000.usb");
    assert_eq!((jetson.speed_mbit, jetson.root_port()), (480, "1-4"));
}

#[test]
fn a_machine_without_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let nodes = list(folder.path(), folder.path()).unwrap();
    assert!(nodes.is_empty());
    let error = find(&nodes, &usb(None)).unwrap_err();
    assert_eq!(error.to_string(), "no camera usb:2b03:f682; there is none");
}

#[test]
fn nodes_that_cannot_be_asked() {
    // The files of the fake are no devices.
    let machine = Machine::rig();
    let nodes = list(&machine.sys(), &machine.dev()).unwrap();
    assert_eq!(nodes.len(), 4);
    assert!(
        nodes
            .iter()
            .all(|n| matches!(n.captures, Err(CameraError::NotACamera { .. })))
    );
    // The first node of the camera, whose opening then says why.
    let node = find(&nodes, &NodeSelector::Path(machine.dev().join("video10"))).unwrap();
    assert_eq!(node.index, 0);
}

#[test]
fn the_one_that_was_meant() {
    let machine = Machine::rig();
    let nodes = machine.list();
    let number = |wanted: &NodeSelector| {
        let found = find(&nodes, wanted).map(|n| n.path.clone());
        found.map(|p| p.file_name().unwrap().to_str().unwrap().to_owned())
    };
    assert_eq!(number(&usb(Some("SN 27"))).unwrap(), "video2");

    let error = number(&usb(None)).unwrap_err().to_string();
    assert!(error.contains("video2 (ZED-M: ZED-M, usb:2b03:f682 in port 1-4, serial SN 27)"));
    assert!(error.contains("video10 (ZED-M: ZED-M, usb:2b03:f682 in port 2-1.3)"));
    assert!(!error.contains("video11") && error.starts_with("more than one camera"));

    let error = number(&usb(Some("SN 28"))).unwrap_err();
    assert!(matches!(&error, FindError::NotThere { there, .. } if there.contains("vivid")));

    let by_path = machine.dev().join("v4l/by-path");
    fs::create_dir_all(&by_path).unwrap();
    let link = by_path.join("pci-0000:00:14.0-usb-0:1.3:1.0-video-index0");
    symlink("../../video10", &link).unwrap();
    assert_eq!(number(&NodeSelector::Path(link)).unwrap(), "video10");
    assert_eq!(
        number(&NodeSelector::Path(machine.dev().join("video0"))).unwrap(),
        "video0"
    );
    // One that is there and captures nothing, and one that is not there.
    for name in ["video11", "video7"] {
        let error = number(&NodeSelector::Path(machine.dev().join(name))).unwrap_err();
        assert!(matches!(error, FindError::NotThere { .. }));
    }
}

#[test]
fn names_of_cameras() {
    for text in [
        "/dev/video0",
        "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:2:1.0-video-index0",
        "usb:2b03:f682",
        "usb:2b03:f682:A:B",
    ] {
        assert_eq!(text.parse::<NodeSelector>().unwrap().to_string(), text);
    }
    assert_eq!("usb:2b03:f682:A:B".parse(), Ok(usb(Some("A:B"))));
    for bad in [
        "",
        "video0",
        "usb:",
        "usb:2b03",
        "usb:2b03:xyz",
        "usb:2b03:f682:",
        "usb:+b03:f682",
    ] {
        let error = bad.parse::<NodeSelector>().unwrap_err();
        assert_eq!(error, NoCamera { found: bad.into() }, "{bad}");
    }
}
