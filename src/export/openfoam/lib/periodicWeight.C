{{notice}}
#include "periodicWeight.H"
#if defined(OPENFOAM)

#include "fvMatrices.H"
#include "volFields.H"
#include "addToRunTimeSelectionTable.H"

namespace Foam
{
namespace fv
{
    defineTypeNameAndDebug(periodicWeight, 0);
    addToRunTimeSelectionTable(option, periodicWeight, dictionary);
}
}

Foam::fv::periodicWeight::periodicWeight
(
    const word& name, const word& type, const dictionary& dict, const fvMesh& mesh
)
:
    option(name, type, dict, mesh),
    g_(coeffs_.get<vector>("g")),
    otherPhase_(coeffs_.get<word>("otherPhase"))
{
    coeffs_.readEntry("fields", fieldNames_);
    applied_.setSize(fieldNames_.size(), false);
}

void Foam::fv::periodicWeight::addSup
(
    const volScalarField& alpha, const volScalarField& rho,
    fvMatrix<vector>& eqn, const label
)
{
    const volScalarField& otherRho =
        mesh_.lookupObject<volScalarField>("thermo:rho." + otherPhase_);
    const volScalarField& otherAlpha =
        mesh_.lookupObject<volScalarField>("alpha." + otherPhase_);
    const scalarField& V = mesh_.V();
    const scalarField mass
    (
        alpha.primitiveField()*rho.primitiveField()
      + otherAlpha.primitiveField()*otherRho.primitiveField()
    );
    const scalarField filled(alpha.primitiveField() + otherAlpha.primitiveField());
    const scalar mean = gSum(V*mass)/gSum(V*filled);
    vectorField& source = eqn.source();
    forAll(source, i)
    {
        source[i] -= V[i]*alpha[i]*(rho[i] - mean)*g_;
    }
}

bool Foam::fv::periodicWeight::read(const dictionary&)
{
    return true;
}

#endif
