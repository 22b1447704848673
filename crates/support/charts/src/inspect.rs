//! What every page has to be: well-formed, and complete without a network.
//!
//! For tests of those who make pages. It knows the HTML that [`crate::Page`] writes and what
//! callers embed in it: every element is closed where its parent is, attributes are quoted. It is
//! no HTML parser.

/// Elements that have no end tag.
const VOID: [&str; 8] = ["meta", "img", "br", "hr", "input", "link", "source", "wbr"];
/// What would fetch something, in text that is no prose: style sheets, scripts, attributes.
const FETCHES: [&str; 8] = [
    "@import",
    "url(",
    "fetch(",
    "XMLHttpRequest",
    "WebSocket",
    "importScripts",
    "sendBeacon",
    "import(",
];
/// Attributes that name what the browser loads or goes to.
const NAMES_A_PLACE: [&str; 8] = [
    "src",
    "href",
    "xlink:href",
    "srcset",
    "data",
    "action",
    "poster",
    "ping",
];

/// Checks that elements are closed in their order, that nothing is fetched from elsewhere, and that
/// scripts and style sheets name no address.
///
/// # Errors
/// The first thing that is wrong, with the text around it.
pub fn inspect(html: &str) -> Result<(), String> {
    let Some(mut rest) = html.strip_prefix("<!DOCTYPE html>") else {
        return Err(format!("no <!DOCTYPE html> at the start: {}", near(html)));
    };
    let mut open: Vec<&str> = Vec::new();
    while let Some((_, from)) = rest.split_once('<') {
        if let Some(comment) = from.strip_prefix("!--") {
            let end = comment.split_once("-->");
            rest = end
                .ok_or_else(|| format!("a comment without an end: {}", near(from)))?
                .1;
            continue;
        }
        let end = tag_end(from).ok_or_else(|| format!("a tag without an end: {}", near(from)))?;
        let (tag, behind) = (&from[..end], &from[end + 1..]);
        rest = behind;
        if let Some(name) = tag.strip_prefix('/') {
            let last = open.pop();
            if last != Some(name) {
                return Err(format!("</{name}> where {last:?} is open: {}", near(rest)));
            }
            continue;
        }
        let name = tag.split([' ', '\n', '/']).next().unwrap_or_default();
        if name.is_empty() || !name.bytes().all(|b| b.is_ascii_alphanumeric()) {
            return Err(format!("a < that begins no element: {}", near(from)));
        }
        attributes(tag)?;
        if matches!(name, "script" | "style") {
            let close = format!("</{name}>");
            let text = rest.split_once(&close);
            let (text, behind) = text.ok_or_else(|| format!("<{name}> without an end"))?;
            let is_data = tag.contains("type=\"application/");
            let found = FETCHES.iter().chain(&["http:", "https:", "\"//", "'//"]);
            if let Some(found) = found.filter(|_| !is_data).find(|f| text.contains(**f)) {
                return Err(format!("{found} in a <{name}>"));
            }
            rest = behind;
        } else if !tag.ends_with('/') && !VOID.contains(&name) {
            open.push(name);
        }
    }
    match open.last() {
        Some(name) => Err(format!("<{name}> is never closed")),
        None => Ok(()),
    }
}

/// Where the tag ends that begins here: the first `>` outside quotes.
fn tag_end(text: &str) -> Option<usize> {
    let mut is_quoted = false;
    text.bytes().position(|b| {
        is_quoted ^= b == b'"';
        b == b'>' && !is_quoted
    })
}

/// Whether the attributes of a tag are quoted, come once, and name no place elsewhere.
fn attributes(tag: &str) -> Result<(), String> {
    let mut seen = Vec::new();
    let mut parts = tag.split('"');
    loop {
        let Some(before) = parts.next() else {
            return Ok(());
        };
        let Some(value) = parts.next() else {
            return match before.contains('=') {
                true => Err(format!("an attribute without quotes: {}", near(tag))),
                false => Ok(()),
            };
        };
        let name = before.trim_end().strip_suffix('=');
        let name = name.and_then(|name| name.split_whitespace().last());
        let name = name.ok_or_else(|| format!("a quote behind no attribute: {}", near(tag)))?;
        if seen.contains(&name) {
            return Err(format!("{name} twice: {}", near(tag)));
        }
        seen.push(name);
        let is_own = value.is_empty() || value.starts_with("data:") || value.starts_with('#');
        if NAMES_A_PLACE.contains(&name) && !is_own {
            return Err(format!("{name} is {}, which is elsewhere", near(value)));
        }
        if name == "style" && FETCHES.iter().any(|f| value.contains(f)) || name.starts_with("on") {
            return Err(format!("{name} is {}", near(value)));
        }
    }
}

fn near(text: &str) -> String {
    text.chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_found() {
        let page = |body: &str| {
            inspect(&format!(
                "<!DOCTYPE html>\n<html><body>{body}</body></html>\n"
            ))
        };
        for good in [
            "",
            "<p>a &lt; b https://example.com is prose</p>",
            "<img src=\"data:image/png;base64,AA==\" alt=\"a > b\"><br>",
            "<svg xmlns=\"http://www.w3.org/2000/svg\"><path d=\"M0 0\"/></svg>",
            "<script>if (1 < 2) { x = \"<p>\" }</script><input type=\"range\" disabled>",
            "<script type=\"application/json\">{\"a\": \"http://prose\"}</script>",
            "<a href=\"#there\">there</a><!-- <p> -->",
        ] {
            assert_eq!(page(good), Ok(()), "{good}");
        }
        for (bad, why) in [
            ("<p>", "</body> where"),
            ("<p><b></p></b>", "</p> where"),
            ("a < b", "begins no element"),
            ("<img src=\"x.png\">", "elsewhere"),
            ("<img src=\"https://example.com/x.png\">", "elsewhere"),
            ("<a href=\"//example.com\">x</a>", "elsewhere"),
            ("<p class=a>x</p>", "without quotes"),
            ("<p id=\"a\" id=\"b\">x</p>", "twice"),
            ("<p onclick=\"x\">x</p>", "onclick"),
            ("<p style=\"background: url(x)\">x</p>", "style"),
            ("<style>p { background: url(x) }</style>", "url("),
            ("<script>fetch(a)</script>", "fetch("),
            ("<script>a = \"https://example.com\"</script>", "https:"),
            ("<script>a = 1", "without an end"),
            ("<!-- a", "without an end"),
        ] {
            let found = page(bad).expect_err(bad);
            assert!(found.contains(why), "{bad}: {found}");
        }
        assert!(inspect("<html></html>").is_err());
    }
}
