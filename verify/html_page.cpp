#include "verify/html_page.h"

#include "support/base64.h"

#include <fmt/format.h>

namespace rt {

namespace {

constexpr const char* style = R"(
:root { color-scheme: light dark; --line: #8886; --good: #1a7f37; --bad: #cf222e; --odd: #9a6700; }
@media (prefers-color-scheme: dark) { :root { --good: #3fb950; --bad: #f85149; --odd: #d29922; } }
body { font: 15px/1.45 system-ui, sans-serif; max-width: 72em; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; } th, td { border: 1px solid var(--line); padding: .25em .6em; text-align: left;
	vertical-align: top; } td.number { text-align: right; font-variant-numeric: tabular-nums; }
thead th { background: #8882; } .scroll { overflow-x: auto; }
.good { color: var(--good); } .bad { color: var(--bad); font-weight: 600; } .odd { color: var(--odd); }
.verdict { padding: .6em 1em; border: 2px solid currentColor; border-radius: .4em; font-size: 1.2em; }
code, .hash { font: .86em ui-monospace, monospace; overflow-wrap: anywhere; }
figure { display: inline-block; margin: 0 1em 1em 0; } figcaption { font-size: .85em; max-width: 16em; }
img { width: 15em; image-rendering: pixelated; border: 1px solid var(--line); display: block; }
)";

} // namespace

std::string html_escape(std::string_view text)
{
	std::string out;
	for (const char c : text)
		switch (c) {
		case '&':
			out += "&amp;";
			break;
		case '<':
			out += "&lt;";
			break;
		case '>':
			out += "&gt;";
			break;
		case '"':
			out += "&quot;";
			break;
		default:
			out += c;
		}
	return out;
}

std::string html_head(std::string_view title)
{
	return fmt::format("<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
	                   "content=\"width=device-width\"><title>{}</title><style>{}</style></head><body>\n",
	                   html_escape(title), style);
}

std::string html_picture(const std::string& caption, const Result<std::vector<std::uint8_t>>& png)
{
	if (!png)
		return fmt::format("<p class=\"bad\">{}: {}</p>\n", html_escape(caption), html_escape(png.error().message));
	return fmt::format("<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption>"
	                   "</figure>\n",
	                   html_escape(caption), to_base64(png->data(), png->size()));
}

} // namespace rt
