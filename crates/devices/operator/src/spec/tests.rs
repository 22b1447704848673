use super::*;

fn reads_back<T: FromStr<Err = SpecError> + fmt::Display + fmt::Debug + PartialEq>(
    text: &str,
) -> T {
    let spec: T = text.parse().unwrap();
    assert_eq!(spec.to_string().parse::<T>().unwrap(), spec, "{text}");
    spec
}

fn refused<T: FromStr<Err = SpecError> + fmt::Debug>(text: &str, says: &str) {
    let error = text.parse::<T>().unwrap_err().to_string();
    assert!(error.contains(says), "{error:?} does not say {says:?}");
}

#[test]
fn every_example_of_the_page_is_read() {
    for text in [
        "gpio:record-button,active-low,pull-up",
        "gpio:/dev/gpiochip0:3,debounce=5",
        "evdev:/dev/input/event3",
        "evdev:name=Shutter remote,key=KEY_ENTER",
        "evdev:key=KEY_RECORD",
        "hid:2b03:f681,byte=1,mask=0x01",
    ] {
        reads_back::<ButtonSpec>(text);
    }
    for text in [
        "gpio:/dev/gpiochip0:4,active-low",
        "gpio:red-led+green-led+blue-led",
        "sysfs:status",
        "sysfs:red+green+blue",
    ] {
        reads_back::<LightSpec>(text);
    }
    for text in ["gpio:beeper", "evdev:name=PC Speaker", "evdev:any"] {
        reads_back::<BeeperSpec>(text);
    }
}

#[test]
fn options_mean_what_they_say() {
    let line = Line::At {
        chip: "/dev/gpiochip2".into(),
        offset: 17,
    };
    assert_eq!(
        reads_back::<ButtonSpec>("gpio:/dev/gpiochip2:17, active-low, pull-down, debounce=5"),
        ButtonSpec::Gpio(GpioButton {
            line,
            active_low: true,
            bias: Some(Bias::PullDown),
            debounce: Duration::from_millis(5),
        })
    );
    assert_eq!(
        reads_back::<ButtonSpec>("hid:2B03:f681,report=3,byte=2,mask=0x40"),
        ButtonSpec::Hid(HidButton {
            vendor: 0x2b03,
            product: 0xf681,
            report: Some(3),
            byte: 2,
            mask: 0x40,
        })
    );
    assert_eq!(
        reads_back::<ButtonSpec>("evdev:"),
        ButtonSpec::Key(KeyButton {
            device: InputDevice::Any,
            key: KeyCode::KEY_RECORD,
        })
    );
}

#[test]
fn what_is_not_understood_is_named() {
    refused::<ButtonSpec>("record-button", "no colon");
    refused::<ButtonSpec>("usb:1:2", "\"usb\"");
    refused::<ButtonSpec>("gpio:", "no line");
    refused::<ButtonSpec>("gpio:/dev/gpiochip0", "a chip without an offset");
    refused::<ButtonSpec>("gpio:/dev/gpiochip0:x", "offset \"x\"");
    refused::<ButtonSpec>("gpio:a,active-lo", "\"active-lo\"");
    refused::<ButtonSpec>("gpio:a,pull-up,pull-down", "two pulls");
    refused::<ButtonSpec>("gpio:a,debounce=-1", "debounce=-1");
    refused::<ButtonSpec>("gpio:a,debounce=5,debounce=6", "\"debounce=6\"");
    refused::<ButtonSpec>("evdev:event3", "\"event3\"");
    refused::<ButtonSpec>("evdev:any,key=RECORD", "key=RECORD");
    refused::<ButtonSpec>("hid:2b03", "\"2b03\"");
    refused::<ButtonSpec>("hid:2b03:f681,mask=0", "mask=0");
    refused::<ButtonSpec>("hid:2b03:f681,mask=256", "mask=256");
    refused::<LightSpec>("sysfs:../../etc", "\"../../etc\"");
    refused::<LightSpec>("gpio:a+b", "2 outputs");
    refused::<BeeperSpec>("gpio:a,loud", "\"loud\"");
}
