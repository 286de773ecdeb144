#include "render/sampling.h"

#include "common/rt_structs.h"

namespace rt {

static_assert(int(Sampler::Independent) == RT_SAMPLER_INDEPENDENT &&
              int(Sampler::Stratified) == RT_SAMPLER_STRATIFIED && int(Sampler::Sobol) == RT_SAMPLER_SOBOL);
static_assert(int(Estimator::Path) == RT_ESTIMATOR_PATH && int(Estimator::Nee) == RT_ESTIMATOR_NEE &&
              int(Estimator::Mis) == RT_ESTIMATOR_MIS);

const char* sampler_name(Sampler sampler)
{
	switch (sampler) {
	case Sampler::Independent:
		return "independent";
	case Sampler::Stratified:
		return "stratified";
	case Sampler::Sobol:
		break;
	}
	return "sobol";
}

const char* estimator_name(Estimator estimator)
{
	switch (estimator) {
	case Estimator::Path:
		return "path";
	case Estimator::Nee:
		return "nee";
	case Estimator::Mis:
		break;
	}
	return "mis";
}

} // namespace rt
