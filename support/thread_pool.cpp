#include "support/thread_pool.h"

#include "support/float_environment.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#ifdef __linux__
#include <sched.h>
#endif

namespace rt {

unsigned thread_count()
{
	static const unsigned count = [] {
		if (const char* text = std::getenv("RT_THREADS")) {
			const long wanted = std::strtol(text, nullptr, 10);
			if (wanted >= 1 && wanted <= 4096)
				return static_cast<unsigned>(wanted);
		}
#ifdef __linux__
		cpu_set_t set;
		CPU_ZERO(&set);
		if (sched_getaffinity(0, sizeof set, &set) == 0)
			return static_cast<unsigned>(std::max(1, CPU_COUNT(&set)));
#endif
		return std::max(1u, std::thread::hardware_concurrency());
	}();
	return count;
}

namespace {

// One call of parallel_for. It lives on the caller's stack until no thread is inside.
struct Job {
	Job(std::uint64_t items, std::uint64_t piece, const std::function<void(std::uint64_t, std::uint64_t)>& what)
	    : count(items), grain(piece), body(what)
	{
	}

	std::uint64_t count, grain;
	const std::function<void(std::uint64_t, std::uint64_t)>& body;
	std::atomic<std::uint64_t> next{0};
	unsigned inside = 0;        // threads of the pool, under its mutex
	std::exception_ptr failure; // the first one, under the pool's mutex

	bool exhausted() const { return next.load() >= count; }
};

// Threads are started once and wait for work: starting them anew costs as much as copying a megabyte each.
class Pool {
public:
	Pool()
	{
		threads_.reserve(thread_count() - 1);
		for (unsigned i = 1; i < thread_count(); ++i)
			threads_.emplace_back([this] { serve(); });
	}
	Pool(const Pool&) = delete;
	Pool& operator=(const Pool&) = delete;
	~Pool()
	{
		{
			const std::lock_guard<std::mutex> lock(mutex_);
			closing_ = true;
		}
		work_.notify_all();
		for (std::thread& thread : threads_)
			thread.join();
	}

	void run(Job& job)
	{
		const bool alone = threads_.empty() || job.count <= job.grain;
		if (!alone) {
			const std::lock_guard<std::mutex> lock(mutex_);
			jobs_.push_back(&job);
		}
		if (!alone)
			work_.notify_all();
		take_pieces(job);
		if (!alone) {
			std::unique_lock<std::mutex> lock(mutex_);
			jobs_.erase(std::find(jobs_.begin(), jobs_.end(), &job));
			left_.wait(lock, [&] { return job.inside == 0; });
		}
		if (job.failure)
			std::rethrow_exception(job.failure);
	}

private:
	void serve()
	{
		std::unique_lock<std::mutex> lock(mutex_);
		for (;;) {
			Job* job = nullptr;
			work_.wait(lock, [&] {
				const auto open = std::find_if(jobs_.begin(), jobs_.end(), [](Job* j) { return !j->exhausted(); });
				job = open == jobs_.end() ? nullptr : *open;
				return closing_ || job;
			});
			if (!job)
				return;
			job->inside += 1;
			lock.unlock();
			take_pieces(*job);
			lock.lock();
			job->inside -= 1;
			left_.notify_all();
		}
	}

	void take_pieces(Job& job)
	{
		const ContractFloatEnvironment environment;
		try {
			for (;;) {
				const std::uint64_t begin = job.next.fetch_add(job.grain);
				if (begin >= job.count)
					return;
				job.body(begin, std::min(job.count, begin + job.grain));
			}
		} catch (...) {
			job.next = job.count;
			const std::lock_guard<std::mutex> lock(mutex_);
			if (!job.failure)
				job.failure = std::current_exception();
		}
	}

	std::mutex mutex_;
	std::condition_variable work_, left_;
	std::vector<Job*> jobs_;
	bool closing_ = false;
	std::vector<std::thread> threads_;
};

} // namespace

void parallel_for(std::uint64_t count, std::uint64_t grain,
                  const std::function<void(std::uint64_t, std::uint64_t)>& body)
{
	if (count == 0)
		return;
	static Pool pool;
	Job job(count, std::max<std::uint64_t>(grain, 1), body);
	pool.run(job);
}

} // namespace rt
