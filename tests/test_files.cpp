#include "support/files.h"
#include "tests/catch.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

namespace fs = std::filesystem;

namespace {

class TemporaryDirectory {
public:
	TemporaryDirectory()
	{
		std::string pattern = (fs::temp_directory_path() / "rt-test-XXXXXX").string();
		REQUIRE(::mkdtemp(pattern.data()) != nullptr);
		path_ = pattern;
	}
	~TemporaryDirectory() { fs::remove_all(path_); }
	std::string operator/(const std::string& name) const { return path_ + "/" + name; }
	std::size_t entries() const
	{
		return static_cast<std::size_t>(std::distance(fs::directory_iterator(path_), fs::directory_iterator()));
	}

private:
	std::string path_;
};

std::string content(const std::string& path)
{
	const auto bytes = rt::read_file(path);
	REQUIRE(bytes);
	return std::string(bytes->begin(), bytes->end());
}

mode_t permissions(const std::string& path)
{
	struct stat info {};
	REQUIRE(::stat(path.c_str(), &info) == 0);
	return info.st_mode & 07777;
}

template <class T>
bool is_io_error(const rt::Result<T>& result, const std::string& where)
{
	return !result && result.error().kind == rt::ErrorKind::InputOutput && result.error().where == where &&
	       !result.error().message.empty() && result.error().message.back() != '.' && !result.error().cure.empty();
}

// While it lives, writing beyond `bytes` of a file fails, as on a full disk.
class FileSizeLimit {
public:
	explicit FileSizeLimit(rlim_t bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN))
	{
		::getrlimit(RLIMIT_FSIZE, &old_);
		rlimit limit = old_;
		limit.rlim_cur = bytes;
		::setrlimit(RLIMIT_FSIZE, &limit);
	}
	~FileSizeLimit()
	{
		::setrlimit(RLIMIT_FSIZE, &old_);
		std::signal(SIGXFSZ, handler_);
	}

private:
	rlimit old_{};
	void (*handler_)(int);
};

} // namespace

TEST_CASE("files are written and read back")
{
	const TemporaryDirectory directory;
	const std::string path = directory / "file";
	REQUIRE(rt::write_file(path, "first"));
	CHECK(content(path) == "first");
	REQUIRE(rt::write_file(path, std::string(300000, 'x')));
	CHECK(content(path) == std::string(300000, 'x'));
	REQUIRE(rt::write_file(path, ""));
	CHECK(content(path).empty());
	CHECK(directory.entries() == 1);

	// In the working directory, and with a name as long as names may be.
	const fs::path before = fs::current_path();
	fs::current_path(directory / ".");
	CHECK(rt::check_writable("plain"));
	CHECK(rt::write_file("plain", "text"));
	CHECK(content("plain") == "text");
	CHECK(rt::write_file(std::string(255, 'n'), "long"));
	CHECK(is_io_error(rt::write_file(std::string(256, 'n'), "long"), std::string(256, 'n')));
	fs::current_path(before);
	CHECK(directory.entries() == 3);
}

TEST_CASE("a write that fails leaves the old file and nothing else")
{
	const TemporaryDirectory directory;
	const std::string path = directory / "file";
	REQUIRE(rt::write_file(path, "old"));
	const std::string large(100000, 'n');
	{
		const FileSizeLimit limit(4096);
		const rt::Status status = rt::write_file(path, large);
		CHECK(is_io_error(status, path));
		CHECK(is_io_error(rt::write_file(directory / "new", large), directory / "new"));
	}
	CHECK(content(path) == "old");
	CHECK(directory.entries() == 1);
	CHECK(rt::write_file(path, large)); // the fault was the limit's
	CHECK(content(path) == large);
}

TEST_CASE("what is not a regular file is written to, not replaced")
{
	const TemporaryDirectory directory;
	const std::string pipe = directory / "pipe";
	REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
	const int reader = ::open(pipe.c_str(), O_RDWR); // keeps the pipe open, so that nobody waits
	REQUIRE(reader >= 0);
	CHECK(rt::check_writable(pipe));
	const bool written = static_cast<bool>(rt::write_file(pipe, "text"));
	// Stops here if the pipe became a file: run by root, the rest would then do the same to the machine's devices.
	REQUIRE(fs::is_fifo(pipe));
	REQUIRE(written);
	char got[5] = {};
	CHECK(::read(reader, got, 4) == 4);
	CHECK(std::string(got) == "text");
	::close(reader);
	CHECK(directory.entries() == 1);

	const rt::Status status = rt::write_file("/dev/full", "text");
	REQUIRE(is_io_error(status, "/dev/full"));
	CHECK(status.error().message.find("No space left") != std::string::npos);
	CHECK(rt::write_file("/dev/null", "text"));
	CHECK(rt::check_writable("/dev/null"));
}

TEST_CASE("places where no file can be")
{
	const TemporaryDirectory directory;
	const std::string file = directory / "file";
	REQUIRE(rt::write_file(file, "old"));
	for (const std::string& path :
	     {file + "/below", directory / "missing/file", directory / ".", directory / "missing/"}) {
		CHECK(is_io_error(rt::write_file(path, "text"), path));
		CHECK(is_io_error(rt::check_writable(path), path));
	}
	CHECK(is_io_error(rt::write_file("", "text"), ""));
	CHECK(is_io_error(rt::check_writable(""), ""));
	CHECK(content(file) == "old");
	CHECK(directory.entries() == 1);

	CHECK(rt::check_writable(file));
	CHECK(rt::check_writable(directory / "new"));
	CHECK(rt::check_writable("-"));
	CHECK(directory.entries() == 1);
	CHECK(content(file) == "old");

	if (::geteuid() != 0) { // nothing is forbidden to root
		::chmod(file.c_str(), 0444);
		CHECK(is_io_error(rt::write_file(file, "text"), file));
		CHECK(is_io_error(rt::check_writable(file), file));
		::chmod((directory / ".").c_str(), 0555);
		CHECK(is_io_error(rt::write_file(directory / "new", "text"), directory / "new"));
		CHECK(is_io_error(rt::check_writable(directory / "new"), directory / "new"));
		::chmod((directory / ".").c_str(), 0755);
	}
}

TEST_CASE("permissions")
{
	const TemporaryDirectory directory;
	const std::string path = directory / "file";
	const mode_t mask = ::umask(027);
	CHECK(rt::write_file(path, "text"));
	::umask(mask);
	CHECK(permissions(path) == 0640);
	for (const mode_t mode : {mode_t(0600), mode_t(0664), mode_t(0755)}) {
		REQUIRE(::chmod(path.c_str(), mode) == 0);
		CHECK(rt::write_file(path, "more"));
		CHECK(permissions(path) == mode);
	}
}

TEST_CASE("symbolic links are followed, not replaced")
{
	const TemporaryDirectory directory;
	REQUIRE(rt::write_file(directory / "file", "old"));
	fs::create_symlink("file", directory / "relative");
	fs::create_symlink(directory / "relative", directory / "absolute");
	fs::create_symlink("later", directory / "dangling");
	fs::create_symlink("loop", directory / "loop");
	CHECK(rt::write_file(directory / "absolute", "new"));
	CHECK(content(directory / "file") == "new");
	CHECK(fs::is_symlink(directory / "absolute"));
	CHECK(fs::is_symlink(directory / "relative"));
	CHECK(rt::check_writable(directory / "dangling"));
	CHECK(rt::write_file(directory / "dangling", "text"));
	CHECK(content(directory / "later") == "text");
	CHECK(is_io_error(rt::write_file(directory / "loop", "text"), directory / "loop"));
	CHECK(is_io_error(rt::check_writable(directory / "loop"), directory / "loop"));
	CHECK(directory.entries() == 6);
}

TEST_CASE("a temporary name that someone took is not written through")
{
	const TemporaryDirectory directory;
	REQUIRE(rt::write_file(directory / "victim", "old"));
	for (int i = 0; i < 200; ++i)
		fs::create_symlink("victim",
		                   directory / (".rt-" + std::to_string(::getpid()) + "-" + std::to_string(i) + ".tmp"));
	CHECK(rt::write_file(directory / "file", "new"));
	CHECK(content(directory / "file") == "new");
	CHECK(content(directory / "victim") == "old");
	CHECK_FALSE(fs::is_symlink(directory / "file"));
	CHECK(directory.entries() == 202);
}

TEST_CASE("standard output takes all bytes of a slow pipe")
{
	int ends[2];
	REQUIRE(::pipe(ends) == 0);
	const int saved = ::dup(STDOUT_FILENO);
	const std::string text(1 << 20, 'p'); // more than a pipe holds
	const pid_t child = ::fork();
	if (child == 0) {
		::close(ends[0]);
		::fcntl(ends[1], F_SETFL, O_NONBLOCK); // the hard case: the writer must wait by itself
		::dup2(ends[1], STDOUT_FILENO);
		::_exit(rt::write_file("-", text) ? 0 : 1);
	}
	::close(ends[1]);
	std::string got;
	char buffer[5000];
	for (ssize_t count; (count = ::read(ends[0], buffer, sizeof buffer)) > 0;)
		got.append(buffer, static_cast<std::size_t>(count));
	::close(ends[0]);
	::close(saved);
	CHECK(got == text);
}

TEST_CASE("reading has limits")
{
	const TemporaryDirectory directory;
	const std::string path = directory / "file";
	REQUIRE(rt::write_file(path, "12345"));
	CHECK(rt::read_file(path, 5));
	CHECK(is_io_error(rt::read_file(path, 4), path));
	CHECK(is_io_error(rt::read_file("/dev/zero", 100000), "/dev/zero")); // says no size, has no end
	CHECK(is_io_error(rt::read_file(directory / "missing"), directory / "missing"));
	CHECK(is_io_error(rt::read_file(directory / "."), directory / "."));
	CHECK(rt::read_file("/proc/self/stat")); // says size 0
	CHECK_FALSE(content("/proc/self/stat").empty());
}

TEST_CASE("the executable's directory")
{
	CHECK(fs::equivalent(rt::executable_directory(), fs::read_symlink("/proc/self/exe").parent_path()));
}
