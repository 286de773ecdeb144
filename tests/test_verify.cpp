// rt verify: verdicts, exit status, odd surroundings, the ledger, and the HTML page in a browser. The program is run as
// a child process, because surroundings are a process's.
#include "tests/catch.h"

#include "backends/odd_environment.h"
#include "common/rt_contract.h"
#include "render/image_read.h"
#include "support/base64.h"
#include "support/files.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include <sys/wait.h>
#include <unistd.h>

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

std::string text_of(const fs::path& path)
{
	const auto bytes = rt::read_file(path.string());
	return bytes ? std::string(bytes->begin(), bytes->end()) : std::string();
}

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

class Directory {
public:
	Directory()
	{
		std::string pattern = (fs::temp_directory_path() / "rt-test-verify-XXXXXX").string();
		REQUIRE(mkdtemp(pattern.data()) != nullptr);
		path_ = pattern;
	}
	~Directory()
	{
		std::error_code ignored;
		fs::remove_all(path_, ignored);
	}
	Directory(const Directory&) = delete;
	Directory& operator=(const Directory&) = delete;
	std::string operator/(const std::string& name) const { return (path_ / name).string(); }

private:
	fs::path path_;
};

struct Outcome {
	int status = -1;
	std::string out, err;
};

// Runs a shell's command line; the temporary directory's name needs no quotes.
Outcome run(const std::string& command)
{
	const Directory streams;
	const int code =
	    std::system((command + " >" + (streams / "out") + " 2>" + (streams / "err") + " </dev/null").c_str());
	return {WIFEXITED(code) ? WEXITSTATUS(code) : -1, text_of(streams / "out"), text_of(streams / "err")};
}

Outcome verify(const std::string& arguments, const std::string& variables = "")
{
	return run("env " + variables + " '" RT_PROGRAM "' verify " + arguments);
}

Json json_of(const std::string& path) { return Json::parse(text_of(path), nullptr, false); }

// The registration of PoCL, which makes an OpenCL device of every processor; empty where it is not installed.
std::string pocl_registration()
{
	for (const char* path : {"/etc/OpenCL/vendors/pocl.icd"})
		if (fs::exists(path) && std::getenv("OCL_ICD_VENDORS") == nullptr)
			return path;
	WARN("skipped: PoCL is not registered here");
	return {};
}

std::string find_browser()
{
	for (const char* name : {"chromium", "chromium-browser", "google-chrome", "google-chrome-stable"})
		if (run(std::string("command -v ") + name).status == 0)
			return name;
	return {};
}

// A report with something wrong in it where a device can be made to compute wrongly, else one where all is well.
std::string write_page(const Directory& where)
{
	const std::string page = where / "report.html";
	const bool pocl = !pocl_registration().empty();
	const Outcome outcome = verify("--quick --html " + page + (pocl ? "" : " --backend reference"),
	                               pocl ? "POCL_EXTRA_BUILD_FLAGS=-cl-fast-relaxed-math" : "");
	CHECK(outcome.status == (pocl ? 4 : 0));
	return page;
}

} // namespace

TEST_CASE("base64 is RFC 4648's")
{
	const auto encoded = [](const std::string& text) {
		return rt::to_base64(reinterpret_cast<const std::uint8_t*>(text.data()), text.size());
	};
	CHECK(encoded("").empty());
	CHECK(encoded("f") == "Zg==");
	CHECK(encoded("fo") == "Zm8=");
	CHECK(encoded("foo") == "Zm9v");
	CHECK(encoded("foobar") == "Zm9vYmFy");
	CHECK(encoded("\xff\xfe") == "//4=");
	CHECK(encoded(std::string(1, '\0') + "\x80") == "AIA=");
}

TEST_CASE("a GPU that two drivers show is one device, and its parts are several")
{
	rt::Enumeration found;
	const auto add = [&found](const char* backend, const char* platform, const char* pci, const char* uuid) {
		rt::DeviceInfo info;
		info.backend = backend;
		info.platform = platform;
		info.pci = pci;
		info.uuid = uuid;
		found.devices.push_back(info);
	};
	using Pairs = std::vector<std::pair<std::size_t, std::size_t>>;
	add("cuda", "NVIDIA CUDA", "0000:3b:00.0", "a");
	add("opencl", "NVIDIA CUDA", "0000:3b:00.0", "a");
	add("opencl", "rusticl", "0000:03:00.0", "");
	add("opencl", "AMD", "0000:03:00.0", "b");
	add("opencl", "AMD", "0000:04:00.0", "c");
	add("cuda", "NVIDIA CUDA", "0000:af:00.0", "d"); // two parts of one GPU
	add("cuda", "NVIDIA CUDA", "0000:af:00.0", "e");
	add("opencl", "NVIDIA CUDA", "0000:af:00.0", "e");
	add("reference", "host", "", "");
	add("opencl", "PoCL", "", "");
	CHECK(rt::views_of_one_device(found) == Pairs{{0, 1}, {2, 3}, {6, 7}});
	const std::vector<rt::Oddity> odd = rt::odd_environment(found);
	CHECK(std::count_if(odd.begin(), odd.end(), [](const rt::Oddity& oddity) {
		      return oddity.headline() == "devices 0, 1: one device, seen twice: pci:0000:3b:00.0";
	      }) == 1);
}

TEST_CASE("the reference passes, and says so on the screen, in JSON and in the ledger")
{
	const Directory where;
	const std::string json = where / "v.json", ledger = where / "ledger.json";
	const std::string command = "--quick --backend reference --json " + json + " --ledger " + ledger;
	const Outcome outcome = verify(command);
	INFO(outcome.out << outcome.err);
	REQUIRE(outcome.status == 0);
	CHECK(outcome.err.empty());
	for (const char* part : {"numeric contract", "films, generic", "atomic operations", "path segments/s",
	                         "subnormals: * < fma", "passed: 1 of 1 device keeps"})
		CHECK(contains(outcome.out, part));
	const Json report = json_of(json);
	REQUIRE(report.is_object());
	CHECK(report["passed"] == true);
	CHECK(report["contract"] == RT_CONTRACT_VERSION);
	const Json& device = report["devices"][0];
	CHECK(device["backend"] == "reference");
	CHECK(device["self_test"]["items"].size() >= 22);
	CHECK(device["films"].size() == report["scenes"].size());
	CHECK(device["films"].size() >= 9);
	CHECK(device["speed"]["rays_per_second"] > 0);

	const Json first = json_of(ledger);
	CHECK(first["rows"].size() == 1 + device["films"].size());
	for (const Json& row : first["rows"])
		CHECK(row["passed"] == true);
	CHECK(verify(command).status == 0);
	CHECK(json_of(ledger)["rows"].size() == first["rows"].size()); // replaced, not repeated
}

TEST_CASE("the probe alone asks for no film")
{
	const Directory where;
	const Outcome outcome = verify("--probe-only --backend reference --json " + (where / "v.json"));
	CHECK(outcome.status == 0);
	CHECK_FALSE(contains(outcome.out, "films"));
	CHECK(json_of(where / "v.json")["devices"][0]["films"].empty());
}

TEST_CASE("wrong command lines are told")
{
	CHECK(verify("--quick --full").status == 2);
	CHECK(verify("--probe-only --full").status == 2);
	CHECK(verify("--quik").status == 2);
	CHECK(verify("--html -").status == 2);
	CHECK(verify("--device no-such-device").status == 3);
	CHECK(verify("--html /no/such/directory/x.html").status == 7);
	const Directory where;
	REQUIRE(rt::write_file(where / "bad.json", "[1, 2]"));
	const Outcome outcome = verify("--probe-only --backend reference --ledger " + (where / "bad.json"));
	CHECK(outcome.status == 7);
	CHECK(contains(outcome.err, "not a ledger"));
	CHECK(text_of(where / "bad.json") == "[1, 2]");
}

TEST_CASE("a driver that was handed fast-math flags fails, by name of the operation")
{
	if (pocl_registration().empty())
		return;
	const Directory where;
	const Outcome outcome = verify("--quick --json " + (where / "v.json") + " --ledger " + (where / "ledger.json"),
	                               "POCL_EXTRA_BUILD_FLAGS=-cl-fast-relaxed-math");
	CHECK(outcome.status == 4);
	CHECK(contains(outcome.out, "POCL_EXTRA_BUILD_FLAGS=-cl-fast-relaxed-math"));
	CHECK(contains(outcome.out, "WRONG"));
	CHECK(contains(outcome.out, "reciprocal: of "));
	CHECK(contains(outcome.err, "reciprocal"));
	const Json report = json_of(where / "v.json");
	CHECK(report["passed"] == false);
	CHECK_FALSE(report["odd"].empty());
	// The reference beside it passes, and the two differ.
	const std::size_t last = report["devices"].size() - 1;
	CHECK(report["devices"][last]["passed"] == true);
	CHECK(report["differing_pixels"][0][last] > 0);
	bool named = false;
	const Json ledger = json_of(where / "ledger.json");
	for (const Json& row : ledger["rows"])
		named = named || (row["passed"] == false && contains(row["why"], "reciprocal") &&
		                  contains(row["environment"], "fast-relaxed-math"));
	CHECK(named);
}

TEST_CASE("odd surroundings are told")
{
	// A preloaded library that flushes subnormals: told, and the reference passes all the same.
	Outcome outcome = verify("--probe-only --backend reference", "LD_PRELOAD='" RT_FLUSH_PRELOAD "'");
	CHECK(outcome.status == 0);
	CHECK(contains(outcome.out, "odd: LD_PRELOAD="));
#if defined(__x86_64__)
	CHECK(contains(outcome.out, "odd: rt was started in a float environment in which subnormals are flushed"));
#endif
	CHECK_FALSE(contains(verify("--probe-only --backend reference").out, "float environment"));

	const std::string pocl = pocl_registration();
	if (pocl.empty())
		return;
	const Directory vendors;
	fs::copy(pocl, vendors / "one.icd");
	outcome = verify("--probe-only --backend reference", "OCL_ICD_VENDORS=" + (vendors / ""));
	CHECK_FALSE(contains(outcome.out, "registered twice"));
	fs::copy(pocl, vendors / "two.icd");
	outcome = verify("--probe-only --backend reference", "OCL_ICD_VENDORS=" + (vendors / ""));
	CHECK(contains(outcome.out, "odd: device 0: registered twice"));
	// `rt devices` says the same.
	CHECK(contains(run("env OCL_ICD_VENDORS=" + (vendors / "") + " '" RT_PROGRAM "' devices").out, "registered twice"));
#if defined(__x86_64__)
	// A "driver" that flushes subnormals when the loader loads it.
	REQUIRE(rt::write_file(vendors / "two.icd", RT_FLUSH_PRELOAD "\n"));
	outcome = verify("--probe-only --backend reference", "OCL_ICD_VENDORS=" + (vendors / ""));
	CHECK(contains(outcome.out, "odd: since a driver was loaded, in this process subnormals are flushed"));
#endif
}

TEST_CASE("the HTML page stands alone and looks right in a browser")
{
	const Directory where;
	const std::string page = write_page(where);
	std::string html = text_of(page);
	REQUIRE(contains(html, "<h1>rt verify</h1>"));
	for (const char* remote : {"http://", "https://", "<script", "<link", "@import"})
		CHECK_FALSE(contains(html, remote));
	const std::string browser = find_browser();
	if (browser.empty()) {
		WARN("skipped: no Chromium here to open the page with");
		return;
	}
	const std::string headless =
	    browser + " --headless --no-sandbox --disable-gpu --hide-scrollbars --user-data-dir=" + (where / "profile") +
	    " --window-size=1200,3000 ";
	// The page tells what became of its pictures.
	const std::string probe = where / "probe.html";
	REQUIRE(rt::write_file(
	    probe, html +
	               "<script>addEventListener('load', () => { const all = [...document.images]; document.body.dataset."
	               "pictures = all.length + ' pictures, ' + all.filter(i => i.naturalWidth > 0).length + ' decoded'; "
	               "});</script>"));
	const std::string dom = run(headless + "--dump-dom file://" + probe).out;
	std::size_t pictures = 0;
	for (std::size_t at = 0; (at = html.find("<img ", at)) != std::string::npos; ++at)
		++pictures;
	CHECK(pictures >= 9);
	CHECK(contains(dom, "data-pictures=\"" + std::to_string(pictures) + " pictures, " + std::to_string(pictures) +
	                        " decoded\""));

	const std::string shot = where / "page.png";
	CHECK(run(headless + "--screenshot=" + shot + " file://" + page).status == 0);
	const rt::Result<rt::LoadedImage> image = rt::load_image(shot);
	REQUIRE(image);
	std::set<std::vector<float>> colours;
	std::size_t dark = 0;
	for (std::size_t pixel = 0; pixel < image->pixels(); ++pixel) {
		const auto begin = image->values.begin() + static_cast<std::ptrdiff_t>(pixel * image->channels);
		colours.insert(std::vector<float>(begin, begin + 3));
		dark += begin[0] + begin[1] + begin[2] < 300 ? 1 : 0;
	}
	CHECK(colours.size() > 500);         // pictures
	CHECK(dark > image->pixels() / 200); // text
	CHECK(dark < image->pixels() / 2);   // on a light page
}
