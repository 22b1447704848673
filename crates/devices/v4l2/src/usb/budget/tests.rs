use super::*;

fn device(controller: &str, port: &str, speed_mbit: u32) -> UsbDevice {
    UsbDevice {
        vendor: 0x2b03,
        product: 0xf682,
        release: 0,
        serial: None,
        port: port.into(),
        speed_mbit,
        controller: controller.into(),
    }
}

fn yuyv(width: u32, height: u32, rate_hz: u32) -> Format {
    Format {
        fourcc: "YUYV".parse().unwrap(),
        width,
        height,
        bytes_per_line: width * 2,
        size_image: width * height * 2,
        interval: Some(Interval::of_rate(rate_hz)),
    }
}

fn demand(camera: &str, device: UsbDevice, format: Format) -> Demand {
    Demand::of(camera, &device, &format).unwrap()
}

fn problems(demands: &[Demand]) -> Vec<String> {
    let loads = check(demands);
    loads
        .iter()
        .filter(|l| !l.fits())
        .map(ToString::to_string)
        .collect()
}

#[test]
fn demand_of_the_modes_of_a_zed_mini() {
    // The vendor's table, MB/s: HD2K at 15, HD1080 at 30, HD720 at 60, VGA at 100.
    for (width, height, rate_hz, megabytes) in [
        (4416, 1242, 15, 164),
        (3840, 1080, 30, 248),
        (2560, 720, 60, 221),
        (1344, 376, 100, 101),
    ] {
        let d = demand("c", device("x", "1-1", 5000), yuyv(width, height, rate_hz));
        assert_eq!(d.needs / 1_000_000, megabytes, "{}", d.mode);
    }
    let ntsc = Interval {
        numerator: 1001,
        denominator: 30_000,
    };
    assert_eq!(bytes_per_second(1001, ntsc), Some(30_000));
    assert_eq!(bytes_per_second(1002, ntsc), Some(30_030));
    let never = Interval {
        numerator: 0,
        denominator: 1,
    };
    assert_eq!(bytes_per_second(1, never), None);
    assert_eq!(bytes_per_second(u64::MAX, Interval::of_rate(2)), None);
}

#[test]
fn no_one_knows_what_compressed_images_need() {
    let format = Format {
        fourcc: "MJPG".parse().unwrap(),
        ..yuyv(1920, 1080, 30)
    };
    assert_eq!(Demand::of("c", &device("x", "1-1", 480), &format), None);
}

#[test]
fn a_camera_in_a_usb_2_port() {
    let slow = demand(
        "feet",
        device("3610000.usb", "1-2.1", 480),
        yuyv(2560, 720, 30),
    );
    assert_eq!(
        problems(std::slice::from_ref(&slow)),
        [
            "feet in port 1-2.1 (USB 2, 480 Mbit/s): 2560x720 YUYV at 30 fps needs 110.6 MB/s, the port \
             carries 24.3 MB/s; use a USB 3 port and a USB 3 cable",
            "controller 3610000.usb (USB 2, 480 Mbit/s): feet needs 110.6 MB/s, together 110.6 MB/s; it \
             carries 40.0 MB/s; lower a rate or a size, or move a camera to another controller",
        ]
    );
    let small = demand(
        "feet",
        device("3610000.usb", "1-2.1", 480),
        yuyv(640, 480, 30),
    );
    assert_eq!(problems(&[small]), [""; 0]);
}

#[test]
fn three_cameras_on_a_controller() {
    let at = |name, controller, port, rate_hz| {
        demand(
            name,
            device(controller, port, 5000),
            yuyv(2560, 720, rate_hz),
        )
    };
    // 3 x 221 MB/s.
    let mut rig = vec![
        at("left_shoulder", "0000:00:14.0", "2-1", 60),
        at("right_shoulder", "0000:00:14.0", "2-2", 60),
        at("feet", "0000:00:14.0", "2-3", 60),
    ];
    assert_eq!(
        problems(&rig),
        [
            "controller 0000:00:14.0 (USB 3, 5000 Mbit/s): left_shoulder needs 221.2 MB/s, right_shoulder \
             needs 221.2 MB/s, feet needs 221.2 MB/s, together 663.6 MB/s; it carries 620.0 MB/s; lower a \
             rate or a size, or move a camera to another controller"
        ]
    );
    // One of them on another controller, or slower.
    rig[2] = at("feet", "0000:05:00.0", "4-1", 60);
    assert_eq!(problems(&rig), [""; 0]);
    rig[2] = at("feet", "0000:00:14.0", "2-3", 30);
    assert_eq!(problems(&rig), [""; 0]);
    assert_eq!(check(&rig).len(), 4);
}

#[test]
fn a_hub_is_one_link() {
    let at = |name, port| demand(name, device("x", port, 5000), yuyv(3840, 1080, 30));
    let found = problems(&[at("a", "2-1.1"), at("b", "2-1.4.2")]);
    assert_eq!(
        found,
        [
            "hub in port 2-1 of controller x (USB 3, 5000 Mbit/s): a needs 248.9 MB/s, b needs 248.9 MB/s, \
             together 497.7 MB/s; it carries 450.0 MB/s; lower a rate or a size, or plug a camera in elsewhere"
        ]
    );
    assert_eq!(problems(&[at("a", "2-1.1"), at("b", "2-2.1")]), [""; 0]);
}

#[test]
fn speeds_do_not_share() {
    // A mouse's neighbour: USB 2 and USB 3 of one controller are two buses.
    let fast = demand("a", device("x", "2-1", 5000), yuyv(3840, 1080, 30));
    let slow = demand("b", device("x", "1-1", 480), yuyv(640, 480, 30));
    let loads = check(&[fast, slow]);
    assert!(loads.iter().all(Load::fits));
    let available: Vec<_> = loads.iter().map(|l| (l.speed_mbit, l.available)).collect();
    assert_eq!(
        available,
        [
            (480, USB2_CAMERA),
            (5000, 450_000_000),
            (480, USB2_CONTROLLER),
            (5000, USB3_CONTROLLER)
        ]
    );
    assert_eq!(link(10_000), 1_090_909_090);
    assert!(link(20_000) > 2 * link(10_000) - 9);
}
