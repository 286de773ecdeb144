#include "render/image_decoders.h"

#include <ImfChannelList.h>
#include <ImfCompression.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <ImfStringAttribute.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <exception>
#include <new>
#include <stdexcept>
#include <string_view>

namespace rt {

namespace {

class MemoryInput : public Imf::IStream {
public:
	MemoryInput(const std::uint8_t* data, std::size_t bytes) : Imf::IStream("memory"), data_(data), bytes_(bytes) {}
	bool read(char to[], int count) override
	{
		const std::size_t wanted = static_cast<std::size_t>(std::max(count, 0));
		if (position_ > bytes_ || wanted > bytes_ - position_)
			throw std::runtime_error("the file ends too early");
		std::memcpy(to, data_ + position_, wanted);
		position_ += wanted;
		return position_ < bytes_;
	}
	std::uint64_t tellg() override { return position_; }
	void seekg(std::uint64_t position) override { position_ = static_cast<std::size_t>(position); }

private:
	const std::uint8_t* data_;
	std::size_t bytes_, position_ = 0;
};

// Names of the channels that become R, G, B and perhaps A; "" where there is none.
Result<std::array<std::string, 4>> channels_of(const Imf::Header& header, LoadedImage& image)
{
	std::array<std::string, 4> chosen;
	const Imf::ChannelList& list = header.channels();
	const auto has = [&list](const char* name) { return list.findChannel(name) != nullptr; };
	if (has("R") && has("G") && has("B"))
		chosen = {"R", "G", "B", ""};
	else if (has("Y"))
		chosen = {"Y", "Y", "Y", ""};
	if (has("A"))
		chosen[3] = "A";
	std::string all;
	bool is_half = true;
	for (auto i = list.begin(); i != list.end(); ++i) {
		all += fmt::format("{}{}", all.empty() ? "" : ", ", i.name());
		if (std::find(chosen.begin(), chosen.end(), i.name()) == chosen.end()) {
			image.left_out.emplace_back(i.name());
			continue;
		}
		if (i.channel().type == Imf::UINT)
			return broken_image("EXR", fmt::format("channel {} holds integers", i.name()), image.name);
		if (i.channel().xSampling != 1 || i.channel().ySampling != 1)
			return broken_image("EXR", fmt::format("channel {} is subsampled", i.name()), image.name);
		is_half = is_half && i.channel().type == Imf::HALF;
	}
	if (chosen[0].empty())
		return broken_image("EXR", fmt::format("it has no channels R, G, B or Y, but {}", all.empty() ? "none" : all),
		                    image.name);
	image.type = is_half ? PixelType::Half : PixelType::Float;
	image.channels = chosen[3].empty() ? 3 : 4;
	return chosen;
}

void read_provenance(const Imf::Header& header, Provenance& provenance)
{
	constexpr std::string_view prefix = "rt:";
	for (auto i = header.begin(); i != header.end(); ++i)
		if (std::string_view(i.name()).substr(0, prefix.size()) == prefix)
			if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&i.attribute()))
				provenance.emplace_back(i.name() + prefix.size(), text->value());
}

Result<LoadedImage> decode(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	MemoryInput stream(data, bytes);
	Imf::InputFile file(stream, 0); // no threads: a library should not start any unasked
	const Imf::Header& header = file.header();
	const Imath::Box2i &box = header.dataWindow(), &display = header.displayWindow();
	const auto size = [](int least, int most) { return static_cast<std::int64_t>(most) - least + 1; };
	const std::int64_t width = size(box.min.x, box.max.x), height = size(box.min.y, box.max.y);
	RT_TRY(check_image_size(static_cast<std::uint64_t>(std::max<std::int64_t>(width, 0)),
	                        static_cast<std::uint64_t>(std::max<std::int64_t>(height, 0)), name));

	LoadedImage image;
	image.name = name;
	image.format = ImageFormat::Exr;
	image.window = {0, 0, static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height)};
	image.image_width = image.window.width;
	image.image_height = image.window.height;
	// A window within the whole image, as rt writes it; elsewhere the data window may lie anywhere.
	if (box.min.x >= display.min.x && box.min.y >= display.min.y && box.max.x <= display.max.x &&
	    box.max.y <= display.max.y) {
		image.knows_window = true;
		image.image_width = static_cast<std::uint32_t>(size(display.min.x, display.max.x));
		image.image_height = static_cast<std::uint32_t>(size(display.min.y, display.max.y));
		image.window.x = static_cast<std::uint32_t>(size(display.min.x, box.min.x) - 1);
		image.window.y = static_cast<std::uint32_t>(size(display.min.y, box.min.y) - 1);
	}
	using Names = std::array<std::string, 4>;
	RT_TRY_ASSIGN(const Names channels, channels_of(header, image));
	read_provenance(header, image.provenance);

	// The library takes memory for whole chunks of rows, of all channels, before it looks whether the file has them.
	constexpr std::uint64_t small_chunk = 1u << 23, most_values_a_byte = 1u << 11;
	std::uint64_t file_channels = 0;
	for (auto i = header.channels().begin(); i != header.channels().end(); ++i)
		++file_channels;
	const std::uint64_t chunk_rows = header.compression() == Imf::DWAB_COMPRESSION ? 256 : 32; // at most
	if (static_cast<std::uint64_t>(width) * file_channels * chunk_rows >
	    std::max(small_chunk, bytes * most_values_a_byte))
		return broken_image("EXR", fmt::format("{} bytes cannot hold {} x {} pixels", bytes, width, height), name);
	const std::size_t row_values = static_cast<std::size_t>(width) * image.channels;

	// Band by band, so that a short file that claims a large picture fails before memory is taken for it.
	constexpr std::size_t band_values = 1u << 24;
	const std::int64_t band_rows =
	    std::clamp<std::int64_t>(static_cast<std::int64_t>(band_values / row_values), 1, 256);
	std::vector<float> band;
	for (std::int64_t y = 0; y < height; y += band_rows) {
		const std::int64_t rows = std::min(band_rows, height - y);
		band.assign(static_cast<std::size_t>(rows) * row_values, 0);
		const Imath::Box2i part({box.min.x, static_cast<int>(box.min.y + y)},
		                        {box.max.x, static_cast<int>(box.min.y + y + rows - 1)});
		Imf::FrameBuffer frame;
		// A grey file has one channel, and a frame buffer one slice for it: R, copied below.
		const bool is_grey = channels[0] == channels[1];
		for (std::size_t c = 0; c < image.channels; ++c)
			if (!is_grey || c == 0 || c == 3)
				frame.insert(channels[c], Imf::Slice::Make(Imf::FLOAT, band.data() + c, part,
				                                           image.channels * sizeof(float), row_values * sizeof(float)));
		file.setFrameBuffer(frame);
		file.readPixels(part.min.y, part.max.y);
		if (is_grey)
			for (std::size_t i = 0; i < band.size(); i += image.channels)
				band[i + 1] = band[i + 2] = band[i];
		image.values.insert(image.values.end(), band.begin(), band.end());
	}
	return image;
}

} // namespace

Result<LoadedImage> decode_image_exr(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	try {
		return decode(data, bytes, name);
	} catch (const std::bad_alloc&) {
		throw; // decode_image() knows what to say
	} catch (const std::exception& failure) {
		return broken_image("EXR", failure.what(), name);
	}
}

} // namespace rt
