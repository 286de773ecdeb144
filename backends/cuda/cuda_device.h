// cuda_device.h: one CUDA GPU in use: its primary context, one stream, and what lives in them.
//
// Every call makes the context current first, so a device may move between threads. Buffers and programs hold the
// context; it is released with the last of them.
#pragma once

#include "backends/backend.h"
#include "backends/cuda/cuda_api.h"
#include "backends/cuda/nvrtc.h"

namespace rt {

class CudaContext;
class CudaProgram;

class CudaDevice final : public Device {
public:
	// `info` must come from the CUDA backend's enumerate(). Without an NVRTC (nullptr) the embedded programs serve.
	static Result<DeviceHandle> open(const CudaApi& api, const Nvrtc* nvrtc, const DeviceInfo& info);

	Result<ProgramHandle> build(const ProgramSpec& spec) override;
	Status launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
	              const std::vector<Argument>& arguments, std::uint32_t group_size) override;
	Result<BufferHandle> alloc(std::size_t bytes) override;
	Status write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes) override;
	Status read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes) override;
	Status read_pieces(const BufferHandle& buffer, std::size_t offset, std::size_t bytes,
	                   const TakePiece& take) override;
	Status wait() override;

private:
	CudaDevice(std::shared_ptr<CudaContext> context, const Nvrtc* nvrtc, int capability, const DeviceInfo& info);
	Status build_compiled(const ProgramSpec& spec, CudaProgram& program);
	Status build_embedded(const ProgramSpec& spec, CudaProgram& program);

	std::shared_ptr<CudaContext> context_;
	const Nvrtc* nvrtc_;
	int capability_; // 10 major + minor
};

// 10 major + minor of a device's compute capability.
Result<int> cuda_capability(const CudaApi& api, CuDevice device);

} // namespace rt
