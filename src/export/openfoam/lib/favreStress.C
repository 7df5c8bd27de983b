{{notice}}
#include "favreStress.H"
#if defined(OPENFOAM)
    #include "twoPhaseSystem.H"
#else
    #include "phaseSystem.H"
#endif
#include "fvc.H"
#include "fvm.H"
#include "zeroGradientFvPatchFields.H"
#include "addToRunTimeSelectionTable.H"
#include "favre_closure.h"
#include "favreCellWidths.H"

namespace Foam
{
namespace RASModels
{
#if defined(OPENFOAM)
    typedef RASModel<EddyDiffusivity<ThermalDiffusivity
    <
        PhaseCompressibleTurbulenceModel<phaseModel>
    >>> favreStressBase;
#else
    typedef RASModel<phaseCompressible::momentumTransportModel> favreStressBase;
#endif

    defineTypeNameAndDebug(favreStress, 0);
    addToRunTimeSelectionTable(favreStressBase, favreStress, dictionary);
}
}

namespace
{
    // Over rho_s u_t^3/g
    inline double favreViscosity(const double phi, const double D, const double S)
    {
        (void)phi; (void)D; (void)S;
        return favre_max(0.0, {{viscosity}});
    }

    // Over rho_s u_t^2
    inline double favrePressure(const double phi, const double D, const double S)
    {
        (void)phi; (void)D; (void)S;
        return favre_max(0.0, {{pressure}});
    }
}

#if defined(OPENFOAM)
Foam::RASModels::favreStress::favreStress
(
    const volScalarField& alpha, const volScalarField& rho,
    const volVectorField& U, const surfaceScalarField& alphaRhoPhi,
    const surfaceScalarField& phi, const phaseModel& transport,
    const word& propertiesName, const word& type
)
:
    phasePressureModel
    (alpha, rho, U, alphaRhoPhi, phi, transport, propertiesName, type),
#else
Foam::RASModels::favreStress::favreStress
(
    const volScalarField& alpha, const volScalarField& rho,
    const volVectorField& U, const surfaceScalarField& alphaRhoPhi,
    const surfaceScalarField& phi, const viscosity& viscosity, const word& type
)
:
    phasePressureModel(alpha, rho, U, alphaRhoPhi, phi, viscosity, type),
#endif
    ratio_(2),
    g_({{gravity}}),
    uT_(0),
    d_(0),
    width_(),
    slope_
    (
        IOobject("favrePressureSlope", U.instance(), U.mesh()),
        U.mesh(),
        dimensionedScalar("zero", dimPressure, 0),
        zeroGradientFvPatchScalarField::typeName
    )
{
#if defined(OPENFOAM)
    scales(this->coeffDict_);
#else
    scales(this->coeffDict());
#endif
}

void Foam::RASModels::favreStress::scales(const dictionary& coeffs)
{
    coeffs.readIfPresent("filterSizeRatio", ratio_);
    coeffs.readIfPresent("gravity", g_);
    coeffs.readIfPresent("terminalVelocity", uT_);
    coeffs.readIfPresent("diameter", d_);
    if (ratio_ <= 0 || g_ <= 0 || uT_ <= 0 || d_ <= 0)
    {
        FatalIOErrorInFunction(coeffs)
            << "filterSizeRatio " << ratio_ << ", gravity " << g_
            << ", terminalVelocity " << uT_ << ", diameter " << d_
            << ": positive numbers are needed; favreDrag prints the last two"
            << exit(FatalIOError);
    }
    const fvMesh& mesh = slope_.mesh();
    const double u_t = uT_, g = g_, d = d_;
    const double L = {{length}};
    (void)d;
    width_ = (ratio_/L)*favreCellWidths(mesh);
}

Foam::tmp<Foam::surfaceScalarField> Foam::RASModels::favreStress::pPrimef() const
{
    return phasePressureModel::pPrimef() + fvc::interpolate(slope_);
}

#if defined(OPENFOAM)
Foam::tmp<Foam::volScalarField> Foam::RASModels::favreStress::pPrime() const
{
    return phasePressureModel::pPrime() + slope_;
}

Foam::tmp<Foam::volSymmTensorField> Foam::RASModels::favreStress::devRhoReff() const
{
    return volSymmTensorField::New
    (
        IOobject::groupName("devRhoReff", U_.group()),
      - (rho_*nut_)*dev(twoSymm(fvc::grad(U_)))
    );
}

Foam::tmp<Foam::fvVectorMatrix>
Foam::RASModels::favreStress::divDevRhoReff(volVectorField& U) const
#else
Foam::tmp<Foam::fvVectorMatrix>
Foam::RASModels::favreStress::divDevTau(volVectorField& U) const
#endif
{
    const volScalarField mu(rho_*nut_);
    return
    (
      - fvm::laplacian(mu, U)
      - fvc::div(mu*dev2(T(fvc::grad(U))), "div(favreStress)")
    );
}

void Foam::RASModels::favreStress::correct()
{
    const volTensorField gradient(fvc::grad(U_));
    // sqrt(2 Sd:Sd), Sd the deviator of the symmetric gradient
    const volScalarField rate(sqrt(2.0)*mag(dev(symm(gradient))));
    const scalar step = 1e-3;
    forAll(nut_, i)
    {
        const scalar a = alpha_[i] > 0 ? alpha_[i] : 0;
        const scalar D = width_[i], S = rate[i]*uT_/g_;
        nut_[i] = favreViscosity(a, D, S)*uT_*uT_*uT_/g_;
        const scalar low = a > step ? a - step : 0;
        const scalar rise =
            (favrePressure(a + step, D, S) - favrePressure(low, D, S))/(a + step - low);
        // A pressure that falls with the fraction cannot be implicit diffusion
        slope_[i] = rise > 0 ? rise*rho_[i]*uT_*uT_ : 0;
    }
    nut_.correctBoundaryConditions();
    slope_.correctBoundaryConditions();
}
