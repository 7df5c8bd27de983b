{{notice}}
#include "favreDrag.H"
#if defined(OPENFOAM)
    #include "phasePair.H"
    #include "swarmCorrection.H"
    #define FAVRE_INTERFACE pair_
#else
    #include "phaseSystem.H"
    #include "dispersedPhaseInterface.H"
    #include "swarmCorrection.H"
    #define FAVRE_INTERFACE interface_
#endif
#include "fvMesh.H"
#include "fvc.H"
#include "addToRunTimeSelectionTable.H"
#include "favre_closure.h"
#include "favreCellWidths.H"
#include "favre_scales.h"

namespace Foam
{
namespace dragModels
{
    defineTypeNameAndDebug(favreDrag, 0);
    addToRunTimeSelectionTable(dragModel, favreDrag, dictionary);
}
}

namespace
{
    // 1 - H, not below zero
    inline double favreFactor
    (const double phi, const double D, const double V, const double S, const double S_g)
    {
        (void)phi; (void)D; (void)V; (void)S; (void)S_g;
        return {{factor}};
    }

    // C_D Re of the drag law: its beta d^2/(phi mu_g) over 3/4
    inline double favreBase(const double phi, const double Re)
    {
        const double a = phi < 0 ? 0 : phi > 0.99 ? 0.99 : phi;
        return {{base}}(a, (1 - a)*Re)/0.75;
    }
}

Foam::dragModels::favreDrag::favreDrag
(
    const dictionary& dict, const FAVRE_PAIR& pair, const bool registerObject
)
:
    FAVRE_BASE(dict, pair, registerObject),
    ratio_(2),
    g_({{gravity}}),
    uT_(0),
    width_(),
    write_(false),
    coefficient_(),
    fraction_(),
    slip_(),
    reynolds_(),
    factor_()
{
    dict.readIfPresent("filterSizeRatio", ratio_);
    dict.readIfPresent("gravity", g_);
    dict.readIfPresent("terminalVelocity", uT_);
    dict.readIfPresent("writeFields", write_);
    if (ratio_ <= 0 || g_ <= 0 || uT_ < 0)
    {
        FatalIOErrorInFunction(dict)
            << "filterSizeRatio " << ratio_ << ", gravity " << g_
            << ", terminalVelocity " << uT_ << ": positive numbers are needed"
            << exit(FatalIOError);
    }
}

Foam::dragModels::favreDrag::~favreDrag()
{}

void Foam::dragModels::favreDrag::scales() const
{
    const volScalarField& phi = FAVRE_INTERFACE.dispersed();
    const fvMesh& mesh = phi.mesh();
    const scalar volume = gSum(mesh.V().field());
    auto mean = [&](const volScalarField& field)
    {
        return gSum(scalarField(field.primitiveField()*mesh.V().field()))/volume;
    };
    const volScalarField diameter(FAVRE_INTERFACE.dispersed().d());
    const scalar d = mean(diameter);
    if (uT_ == 0)
    {
        const volScalarField rhoS(FAVRE_INTERFACE.dispersed().rho());
        const volScalarField rhoG(FAVRE_INTERFACE.continuous().rho());
        const volScalarField nuG(FAVRE_INTERFACE.continuous().nu());
        const scalar rho = mean(rhoG);
        uT_ = favre_terminal_velocity(d, mean(rhoS), rho, mean(nuG)*rho, g_);
    }
    const double u_t = uT_, g = g_;
    const double L = {{length}};
    width_ = (ratio_/L)*favreCellWidths(mesh);
    Info<< "favreDrag: " << FAVRE_CLOSURE_NAME << " " << FAVRE_CLOSURE_SHA256 << nl
        << "favreDrag: diameter " << d << ", u_t " << u_t << ", reference length " << L
        << ", filter width over it " << gMin(width_) << " to " << gMax(width_) << endl;
}

Foam::tmp<Foam::volScalarField> Foam::dragModels::favreDrag::CdRe() const
{
    if (width_.size() != FAVRE_INTERFACE.dispersed().mesh().nCells())
    {
        scales();
    }
    const volScalarField& phi = FAVRE_INTERFACE.dispersed();
    const volScalarField slip(FAVRE_INTERFACE.magUr());
    const scalar rate = uT_/g_;
{{rates}}
    const volScalarField Re(FAVRE_INTERFACE.Re());
    volScalarField factor(Re);
    tmp<volScalarField> tResult(new volScalarField("CdRe", Re));
    volScalarField& result = tResult.ref();
    forAll(result, i)
    {
        factor[i] = favreFactor(phi[i], width_[i], slip[i]/uT_, {{cell_rates}});
        result[i] = factor[i]*favreBase(phi[i], Re[i]);
    }
    // A face of a boundary has the filter width of its cell
    forAll(result.boundaryField(), p)
    {
        fvPatchScalarField& face = result.boundaryFieldRef()[p];
        fvPatchScalarField& faceFactor = factor.boundaryFieldRef()[p];
        const labelUList& cells = face.patch().faceCells();
        const scalarField& facePhi = phi.boundaryField()[p];
        const scalarField& faceRe = Re.boundaryField()[p];
        const scalarField& faceSlip = slip.boundaryField()[p];
        forAll(face, f)
        {
            const label i = cells[f];
            faceFactor[f] =
                favreFactor(facePhi[f], width_[i], faceSlip[f]/uT_, {{cell_rates}});
            face[f] = faceFactor[f]*favreBase(facePhi[f], faceRe[f]);
        }
    }
    (void)rate;
    if (write_)
    {
        keep(factor_, "favreDragFactor", factor);
        keep(fraction_, "favreDragFraction", phi);
        keep(slip_, "favreDragSlip", slip);
        keep(reynolds_, "favreDragRe", Re);
    }
    return tResult;
}

Foam::tmp<Foam::volScalarField> Foam::dragModels::favreDrag::K() const
{
    tmp<volScalarField> tK(FAVRE_BASE::K());
    if (write_)
    {
        keep(coefficient_, "favreDragCoefficient", tK());
    }
    return tK;
}

void Foam::dragModels::favreDrag::keep
(autoPtr<volScalarField>& to, const char* name, const volScalarField& from) const
{
    if (!to.valid())
    {
        to.reset
        (
            new volScalarField
            (
                IOobject
                (
                    name, from.mesh().time().timeName(), from.mesh(),
                    IOobject::NO_READ, IOobject::AUTO_WRITE
                ),
                from.mesh(),
                dimensionedScalar("zero", from.dimensions(), 0)
            )
        );
    }
    volScalarField& field = to();
    forAll(field, i)
    {
        field[i] = from[i];
    }
    field.correctBoundaryConditions();
}
