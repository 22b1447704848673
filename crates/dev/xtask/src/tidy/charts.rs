//! The texts of charts: the `<text>` elements of an SVG file.

/// A text of a chart.
#[derive(Debug, PartialEq)]
pub(crate) struct Label {
    /// Line of the file on which the element begins, counted from 1.
    pub(crate) line: usize,
    pub(crate) text: String,
}

/// Every text, without the tags inside it and with entities replaced.
pub(crate) fn labels(svg: &str) -> Vec<Label> {
    let mut labels = Vec::new();
    let mut at = 0;
    let mut line = 1;
    while let Some(found) = svg[at..].find("<text") {
        let start = at + found;
        line += svg[at..start].matches('\n').count();
        let element = &svg[start..];
        at = start + 1;
        // `<textPath` is another element, and `<text/>` has no text.
        let Some((tag, behind)) = element["<text".len()..].split_once('>') else {
            break;
        };
        if tag.ends_with('/') || tag.starts_with(|c: char| !c.is_whitespace()) {
            continue;
        }
        let content = behind.split("</text>").next().unwrap_or_default();
        labels.push(Label {
            line,
            text: unescape(&without_tags(content)),
        });
    }
    labels
}

fn without_tags(content: &str) -> String {
    let mut text = String::new();
    let mut inside = false;
    for c in content.chars() {
        match c {
            '<' => inside = true,
            '>' => {
                inside = false;
                text.push(' ');
            }
            _ if inside => {}
            _ => text.push(c),
        }
    }
    text
}

fn unescape(text: &str) -> String {
    let mut text = text.to_owned();
    for (entity, c) in [
        ("&#39;", "'"),
        ("&apos;", "'"),
        ("&quot;", "\""),
        ("&lt;", "<"),
        ("&gt;", ">"),
        ("&amp;", "&"),
    ] {
        text = text.replace(entity, c);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_texts_are_read() {
        let svg = "<svg><title>a</title>\n<text x=\"1\">the rig&#39;s &lt; b</text>\n\
                   <textPath>no</textPath><text/>\n<text>one <tspan>two</tspan></text>\n<text>open";
        let labels = labels(svg);
        let found: Vec<_> = labels.iter().map(|l| (l.line, l.text.as_str())).collect();
        assert_eq!(found, [(2, "the rig's < b"), (4, "one  two "), (5, "open")]);
    }
}
