#include "support/files.h"

#include <fmt/format.h>

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <climits>
#include <new>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace rt {

namespace {

std::string cure_for(int code)
{
	switch (code) {
	case ENOENT:
	case ENOTDIR:
		return "check the path; for a new file, create its directory first";
	case EACCES:
	case EPERM:
		return "choose a place where you may read and write, or change the permissions";
	case EROFS:
		return "the file system is read-only: choose another place";
	case EISDIR:
		return "name a file, not a directory";
	case ENOSPC:
		return "free some space or choose another file system";
	case EDQUOT:
		return "your disk quota is used up: free some space or choose another file system";
	case EFBIG:
		return "the file would exceed the size limit (ulimit -f) or what the file system can hold";
	case EMFILE:
	case ENFILE:
		return "too many files are open: close some or raise the limit (ulimit -n)";
	case ENAMETOOLONG:
		return "choose a shorter name";
	case EPIPE:
		return "the program that reads the output has ended";
	default:
		return "check the path and the file system";
	}
}

Error system_error(const std::string& what, const std::string& path, int code)
{
	return {ErrorKind::InputOutput,
	        fmt::format("{}: {}", what, std::generic_category().message(code)),
	        path,
	        cure_for(code),
	        {}};
}

// Closes on every way out; close() reports the error that a network file system keeps until then.
class Descriptor {
public:
	explicit Descriptor(int number) : number_(number) {}
	~Descriptor()
	{
		if (number_ >= 0)
			::close(number_);
	}
	Descriptor(const Descriptor&) = delete;
	Descriptor& operator=(const Descriptor&) = delete;
	explicit operator bool() const { return number_ >= 0; }
	int number() const { return number_; }
	int close() { return ::close(std::exchange(number_, -1)); }

private:
	int number_;
};

int open_retrying(const std::string& path, int flags, mode_t mode = 0)
{
	int number;
	do
		number = ::open(path.c_str(), flags | O_CLOEXEC, mode);
	while (number < 0 && errno == EINTR);
	return number;
}

// Returns 0 or the error's number. write() may take less than it is given, and a signal may come between.
int write_all(int descriptor, const void* data, std::size_t bytes)
{
	const char* next = static_cast<const char*>(data);
	while (bytes != 0) {
		const ssize_t taken = ::write(descriptor, next, std::min<std::size_t>(bytes, std::size_t(1) << 30));
		if (taken > 0) {
			next += taken;
			bytes -= static_cast<std::size_t>(taken);
		} else if (taken == 0) {
			return EIO;
		} else if (errno == EAGAIN) { // standard output may have been made non-blocking by its other users
			pollfd ready{descriptor, POLLOUT, 0};
			if (::poll(&ready, 1, -1) < 0 && errno != EINTR)
				return errno;
		} else if (errno != EINTR) {
			return errno;
		}
	}
	return 0;
}

// Some file systems cannot synchronise; that is no failure to write.
int synchronise(int descriptor)
{
	while (::fsync(descriptor) != 0) {
		if (errno == EINVAL || errno == ENOSYS || errno == ENOTSUP || errno == EROFS)
			return 0;
		if (errno != EINTR)
			return errno;
	}
	return 0;
}

std::string directory_of(const std::string& path)
{
	const std::size_t slash = path.rfind('/');
	if (slash == std::string::npos)
		return ".";
	return slash == 0 ? "/" : path.substr(0, slash);
}

// The file that a symbolic link names, whether it exists or not: renaming over the link would cut it.
Result<std::string> follow_links(std::string path)
{
	const std::string asked = path;
	for (int links = 0; links < 40; ++links) {
		char buffer[PATH_MAX];
		const ssize_t length = ::readlink(path.c_str(), buffer, sizeof buffer);
		if (length < 0)
			return path; // not a link; any other trouble shows when the file is created
		const std::string target(buffer, static_cast<std::size_t>(length));
		path = target.front() == '/' ? target : directory_of(path) + "/" + target;
	}
	return system_error("could not follow the symbolic link", asked, ELOOP);
}

// A file that exists only until it is renamed: removed on every other way out.
class TemporaryFile {
public:
	// In the target's directory, because rename() works within one file system only. The name is short, so that a
	// long target name cannot make it too long.
	TemporaryFile(const std::string& directory, mode_t mode)
	{
		static std::atomic<unsigned> counter{0};
		do {
			path_ = fmt::format("{}/.rt-{}-{}.tmp", directory, ::getpid(), counter++);
			number_ = open_retrying(path_, O_WRONLY | O_CREAT | O_EXCL, mode);
		} while (number_ < 0 && errno == EEXIST);
	}
	~TemporaryFile()
	{
		if (number_ >= 0)
			::unlink(path_.c_str());
	}
	TemporaryFile(const TemporaryFile&) = delete;
	TemporaryFile& operator=(const TemporaryFile&) = delete;
	explicit operator bool() const { return number_ >= 0; }
	int number() const { return number_; }
	int rename_to(const std::string& target)
	{
		if (::rename(path_.c_str(), target.c_str()) != 0)
			return errno;
		number_ = -1;
		return 0;
	}

private:
	std::string path_;
	int number_ = -1;
};

const char* const cannot_write = "could not write the file";

Status write_directly(const std::string& path, const void* data, std::size_t bytes)
{
	Descriptor file(open_retrying(path, O_WRONLY));
	if (!file)
		return system_error(cannot_write, path, errno);
	if (const int code = write_all(file.number(), data, bytes))
		return system_error(cannot_write, path, code);
	if (file.close() != 0)
		return system_error(cannot_write, path, errno);
	return success();
}

Status replace_file(const std::string& path, const void* data, std::size_t bytes, const struct stat* old)
{
	const std::string directory = directory_of(path);
	// A private target's new content must be private from the first byte; otherwise the umask decides, as for any file.
	TemporaryFile temporary(directory, old ? 0600 : 0666);
	if (!temporary)
		return system_error(cannot_write, path, errno);
	Descriptor file(temporary.number());
	if (old && ::fchmod(file.number(), old->st_mode & 07777) != 0)
		return system_error(cannot_write, path, errno);
	if (const int code = write_all(file.number(), data, bytes))
		return system_error(cannot_write, path, code);
	if (const int code = synchronise(file.number()))
		return system_error(cannot_write, path, code);
	if (file.close() != 0)
		return system_error(cannot_write, path, errno);
	if (const int code = temporary.rename_to(path))
		return system_error(cannot_write, path, code);

	// The name is safe only when the directory is; one that may not be read cannot be synchronised.
	Descriptor folder(open_retrying(directory, O_RDONLY | O_DIRECTORY));
	if (folder)
		if (const int code = synchronise(folder.number()))
			return system_error("could not make the file's name permanent", path, code);
	return success();
}

} // namespace

Result<std::vector<std::uint8_t>> read_file(const std::string& path, std::uint64_t max_bytes)
{
	static const char* const cannot_read = "could not read the file";
	Descriptor file(open_retrying(path, O_RDONLY));
	struct stat info {};
	if (!file || ::fstat(file.number(), &info) != 0)
		return system_error(cannot_read, path, errno);

	const auto too_large = [&] {
		return Error{ErrorKind::InputOutput,
		             fmt::format("the file is larger than {} bytes", max_bytes),
		             path,
		             "check that this is the right file",
		             {}};
	};
	const bool sized = S_ISREG(info.st_mode);
	const std::uint64_t expected = sized ? static_cast<std::uint64_t>(info.st_size) : 0;
	if (expected > max_bytes)
		return too_large();

	// One byte of room beyond the expected size lets the end of the file show without growing the buffer.
	std::vector<std::uint8_t> content;
	std::size_t used = 0;
	try {
		content.resize(expected + 1);
		for (;;) {
			if (used == content.size())
				content.resize(std::max<std::size_t>(65536, 2 * content.size()));
			const ssize_t got = ::read(file.number(), content.data() + used,
			                           std::min<std::size_t>(content.size() - used, std::size_t(1) << 30));
			if (got < 0) {
				if (errno == EINTR)
					continue;
				return system_error(cannot_read, path, errno);
			}
			if (got == 0)
				break;
			used += static_cast<std::size_t>(got);
			if (used > max_bytes)
				return too_large();
		}
		content.resize(used);
	} catch (const std::bad_alloc&) {
		return Error{
		    ErrorKind::Memory, "the file does not fit in memory", path, "check that this is the right file", {}};
	} catch (const std::length_error&) {
		return Error{
		    ErrorKind::Memory, "the file does not fit in memory", path, "check that this is the right file", {}};
	}
	return content;
}

Status write_file(const std::string& path, const void* data, std::size_t bytes)
{
	if (path == "-") {
		if (const int code = write_all(STDOUT_FILENO, data, bytes))
			return system_error("could not write to standard output", path, code);
		return success();
	}
	RT_TRY_ASSIGN(const std::string target, follow_links(path));
	struct stat info {};
	if (::stat(target.c_str(), &info) != 0)
		return replace_file(target, data, bytes, nullptr);
	if (S_ISDIR(info.st_mode))
		return system_error(cannot_write, path, EISDIR);
	if (!S_ISREG(info.st_mode))
		return write_directly(target, data, bytes); // a device or a pipe is not to be replaced by a file
	// Renaming does not ask whether the old file may be written; its owner does.
	if (::access(target.c_str(), W_OK) != 0)
		return system_error(cannot_write, path, errno);
	return replace_file(target, data, bytes, &info);
}

Status write_file(const std::string& path, std::string_view text) { return write_file(path, text.data(), text.size()); }

Status check_writable(const std::string& path)
{
	static const char* const cannot_create = "the file cannot be written";
	if (path == "-")
		return success();
	RT_TRY_ASSIGN(const std::string target, follow_links(path));
	struct stat info {};
	const bool exists = ::stat(target.c_str(), &info) == 0;
	if ((exists && S_ISDIR(info.st_mode)) || target.empty() || target.back() == '/')
		return system_error(cannot_create, path, target.empty() ? ENOENT : EISDIR);
	if (!exists && errno != ENOENT)
		return system_error(cannot_create, path, errno);
	if (exists && ::access(target.c_str(), W_OK) != 0)
		return system_error(cannot_create, path, errno);
	if (exists && !S_ISREG(info.st_mode))
		return success();
	// Only a trial tells for sure: permissions, read-only file systems and quotas all have a say.
	const TemporaryFile trial(directory_of(target), 0600);
	if (!trial)
		return system_error(cannot_create, path, errno);
	const Descriptor file(trial.number());
	return success();
}

std::string executable_directory()
{
	char buffer[PATH_MAX];
	const ssize_t length = ::readlink("/proc/self/exe", buffer, sizeof buffer);
	if (length <= 0 || static_cast<std::size_t>(length) == sizeof buffer)
		return {};
	return directory_of(std::string(buffer, static_cast<std::size_t>(length)));
}

} // namespace rt
